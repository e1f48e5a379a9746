"""Trust region policy optimisation of one policy on whole episodes (cmdp-spec, 7.4).

Schulman et al. 2015: maximise the surrogate mean(ratio x advantage) under mean KL(old, new) <=
delta. The direction is F^-1 g by conjugate gradients, F the Hessian of the KL; the step is the
largest that the quadratic model of the KL allows, then halved until the surrogate really rises and
the KL holds.

Notation (shapes of one policy): D decisions, E episodes, A agents, f features.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree

from mbtl.engine.learners import networks
from mbtl.engine.learners.clock import Clock
from mbtl.engine.learners.descent import mean_of, standard
from mbtl.engine.learners.episodic.episodes import Episodes
from mbtl.engine.learners.episodic.returns import Memory, Returns, advantages
from mbtl.engine.learners.networks import Network, Weights
from mbtl.engine.learners.ppo import Batch
from mbtl.engine.learners.recipes import TRPORecipe
from mbtl.engine.worlds.environments import Box, Discrete, Tree

Search = tuple[jax.Array, jax.Array, jax.Array]
"""Tries of the line search, the share of the step, and whether it is good."""

Residual = tuple[jax.Array, jax.Array, jax.Array, jax.Array]
"""Of conjugate gradients: solution, residual, direction, squared norm of the residual."""


def start(recipe: TRPORecipe, weights: Weights) -> Memory:
    """Before the first update."""
    return Memory(_adam(recipe).init(weights.critic), Returns.empty())


def learn(
    action: Discrete | Box,
    recipe: TRPORecipe,
    weights: Weights,
    memory: Memory,
    lived: Episodes,
    clock: Clock,
) -> tuple[Weights, Memory]:
    """One update of the actor and `critic_passes` steps of the critic, on all rows.

    The episodes are without the axis of policies. Nothing is drawn. The clock's rate is that of
    the step, which goes as the root of `max_kl`; the critic's stays.
    """
    advantage, target, returns = advantages(recipe, memory.returns, lived)
    actions = lived.action
    if recipe.clip_actions:
        actions = networks.to_environment(actions, action)
    log_prob = networks.log_prob(lived.outputs, weights.log_std, actions, action)
    weight = lived.acting.astype(jnp.float32)
    learnt = (lived.obs[lived.row], actions, log_prob, advantage, target)
    rows = (*learnt, lived.outputs, lived.value, weight)
    batch = Batch(*(x.reshape(-1, *x.shape[3:]) for x in rows))
    if recipe.normalize_advantage:
        batch = batch._replace(advantage=standard(batch.advantage, batch.weight))
    actor, log_std = _natural_step(action, recipe, weights, batch, clock.rate)
    critic, moments = _fit_critic(recipe, weights.critic, memory.moments, batch)
    return Weights(actor, critic, log_std), Memory(moments, returns)


# ---- actor -----------------------------------------------------------------------------------


def _natural_step(
    action: Discrete | Box, recipe: TRPORecipe, weights: Weights, batch: Batch, rate: jax.Array
) -> tuple[Network, jax.Array]:
    max_kl = recipe.max_kl * jnp.square(rate)
    flat, unravel = ravel_pytree((weights.actor, weights.log_std))

    def outputs_of(theta: jax.Array) -> tuple[jax.Array, jax.Array]:
        actor, log_std = unravel(theta)
        return networks.apply(actor, batch.obs, recipe.activation), log_std

    def surrogate(theta: jax.Array) -> jax.Array:
        outputs, log_std = outputs_of(theta)
        ratio = jnp.exp(networks.log_prob(outputs, log_std, batch.action, action) - batch.log_prob)
        return mean_of(ratio * batch.advantage, batch.weight)

    def divergence(theta: jax.Array) -> jax.Array:
        outputs, log_std = outputs_of(theta)
        return mean_of(
            networks.kl(batch.outputs, weights.log_std, outputs, log_std, action), batch.weight
        )

    before, gradient = jax.value_and_grad(surrogate)(flat)

    def curvature(x: jax.Array) -> jax.Array:
        return jax.jvp(jax.grad(divergence), (flat,), (x,))[1] + recipe.damping * x

    direction = conjugate_gradients(curvature, gradient, recipe.cg_steps)
    length = jnp.sqrt(2.0 * max_kl / jnp.maximum(direction @ curvature(direction), 1e-12))
    step = length * direction
    expected = gradient @ step

    def shorten(carry: Search) -> Search:
        tries, share, _ = carry
        share = jnp.where(tries == 0, 1.0, share * recipe.backtrack)
        theta = flat + share * step
        gain = surrogate(theta) - before
        good = (gain > recipe.accept * share * expected) & (divergence(theta) <= max_kl)
        return tries + 1, share, good

    def going_on(carry: Search) -> jax.Array:
        return (carry[0] < recipe.backtracks) & ~carry[2]

    first = (jnp.int32(0), jnp.float32(1.0), jnp.array(False))
    _, share, good = jax.lax.while_loop(going_on, shorten, first)
    good &= jnp.isfinite(step).all()
    chosen: tuple[Network, jax.Array] = unravel(jnp.where(good, flat + share * step, flat))
    return chosen


def conjugate_gradients(
    product: Callable[[jax.Array], jax.Array], b: jax.Array, steps: int
) -> jax.Array:
    """Approximate solution x of A x = b for a positive definite A, from x = 0.

    `product` is x -> A x; iterations after the residual has vanished change nothing.
    """

    def one(_: int, carry: Residual) -> Residual:
        x, r, p, rr = carry
        q = product(p)
        alpha = jnp.where(rr > 1e-12, rr / jnp.maximum(p @ q, 1e-20), 0.0)
        x, r = x + alpha * p, r - alpha * q
        new = r @ r
        return x, r, r + (new / jnp.maximum(rr, 1e-20)) * p, new

    solution: jax.Array = jax.lax.fori_loop(0, steps, one, (jnp.zeros_like(b), b, b, b @ b))[0]
    return solution


# ---- critic ----------------------------------------------------------------------------------


def _fit_critic(
    recipe: TRPORecipe, critic: Network, moments: Tree, batch: Batch
) -> tuple[Network, Tree]:
    def loss(critic: Network) -> jax.Array:
        value = networks.apply(critic, batch.obs, recipe.activation)[..., 0]
        return mean_of(jnp.square(batch.target - value), batch.weight)

    def one(_: int, carry: tuple[Network, Tree]) -> tuple[Network, Tree]:
        critic, moments = carry
        steps, moments = _adam(recipe).update(jax.grad(loss)(critic), moments)
        return jax.tree.map(jnp.add, critic, steps), moments

    critic, moments = jax.lax.fori_loop(0, recipe.critic_passes, one, (critic, moments))
    return critic, moments


def _adam(recipe: TRPORecipe) -> optax.GradientTransformation:
    return optax.adam(recipe.critic_learning_rate)
