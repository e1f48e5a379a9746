"""Proximal policy optimisation of one policy, written to be vectorised over many with `jax.vmap`.

State in, state out: `init` makes a state, `update` plays one rollout and learns from it. Semantics
are those of Stable-Baselines3 (advantage normalisation per minibatch, bootstrap at truncation,
no clipping of values), so its recipe gives its learning curves.

Notation (shapes of one policy): T steps, E environment copies, B minibatch, o observation.
    obs (T, E, o); action (T, E) or (T, E, d); reward, value, advantage, target (T, E)
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from mbtl.training.jax import networks
from mbtl.training.jax.environments import Environment, Tree
from mbtl.training.jax.networks import Weights
from mbtl.training.jax.recipes import PPORecipe


class State(NamedTuple):
    """All of one training: with the next `update`'s arguments it decides everything to come.

    Attributes:
        weights: the networks.
        optimizer: Adam's moments.
        env: states of the E copies.
        elapsed: (E,) steps since each copy was reset.
        key: the policy's own random key.
    """

    weights: Weights
    optimizer: Tree
    env: Tree
    elapsed: jax.Array
    key: jax.Array


class Rollout(NamedTuple):
    """What T steps of E copies gave; `after` is the observation before a reset."""

    obs: jax.Array
    outputs: jax.Array
    action: jax.Array
    reward: jax.Array
    terminated: jax.Array
    done: jax.Array
    after: jax.Array


class Batch(NamedTuple):
    """Transitions to learn from, one leading axis."""

    obs: jax.Array
    action: jax.Array
    log_prob: jax.Array
    advantage: jax.Array
    target: jax.Array


def init(env: Environment, recipe: PPORecipe, seeds: Sequence[int], params: Tree) -> State:
    """Fresh networks and freshly reset environments of all policies.

    Args:
        env: the dynamics.
        recipe: hyper-parameters.
        seeds: one per policy, 32 bits; decides its whole training.
        params: one context per policy, leading axis.
    """
    n_inputs = env.n_features + params.visible.shape[-1]
    each = [
        networks.init_weights(seed, n_inputs, env.action, recipe.hidden, recipe.log_std)
        for seed in seeds
    ]
    weights = jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *each)
    roots = jnp.asarray(np.array(seeds, dtype=np.uint32))
    state: State = _start(env, recipe, weights, roots, params)
    return state


@partial(jax.jit, static_argnums=(0, 1))
@partial(jax.vmap, in_axes=(None, None, 0, 0, 0))
def _start(
    env: Environment, recipe: PPORecipe, weights: Weights, seed: jax.Array, params: Tree
) -> State:
    key, reset_key = jax.random.split(jax.random.PRNGKey(seed))
    noise = jax.random.uniform(reset_key, (recipe.n_envs, env.n_noise))
    return State(
        weights,
        _optimizer(recipe).init(weights),
        jax.vmap(env.initial, (0, None))(noise, params),
        jnp.zeros(recipe.n_envs, dtype=jnp.int32),
        key,
    )


def update(
    env: Environment,
    recipe: PPORecipe,
    state: State,
    params: Tree,
    shuffle: jax.Array,
    scale: jax.Array,
) -> State:
    """One rollout and the gradient steps on it.

    Args:
        env: the dynamics; static.
        recipe: hyper-parameters; static.
        state: one policy's.
        params: its context.
        shuffle: random key of the order of the minibatches. One order for all policies, a function
            of the number of the update alone, so that a policy does not depend on its company:
            sorting apart for each would cost a tenth of the training.
        scale: factor of the learning rate.
    """
    state, rollout = play(env, recipe, state, params)
    batch = learn_from(env, recipe, state.weights, rollout)
    loss = jax.grad(_loss, argnums=2)

    def minibatch(carry: tuple[Weights, Tree], part: Batch) -> tuple[tuple[Weights, Tree], None]:
        weights, moments = carry
        gradient = loss(env, recipe, weights, part)
        steps, moments = _optimizer(recipe).update(gradient, moments)
        weights = jax.tree.map(lambda w, s: w + scale * s, weights, steps)
        return (weights, moments), None

    def epoch(carry: tuple[Weights, Tree], key: jax.Array) -> tuple[tuple[Weights, Tree], None]:
        order = jax.random.permutation(key, recipe.steps_per_update)
        parts = jax.tree.map(lambda x: x[order].reshape(-1, recipe.batch_size, *x.shape[1:]), batch)
        carry, _ = jax.lax.scan(minibatch, carry, parts)
        return carry, None

    learnt, _ = jax.lax.scan(
        epoch, (state.weights, state.optimizer), jax.random.split(shuffle, recipe.n_epochs)
    )
    return state._replace(weights=learnt[0], optimizer=learnt[1])


def play(env: Environment, recipe: PPORecipe, state: State, params: Tree) -> tuple[State, Rollout]:
    """T steps of the E copies with sampled actions; a copy that has ended starts anew."""
    key, action_key, reset_key = jax.random.split(state.key, 3)
    shape = (recipe.n_steps, recipe.n_envs)
    noise = (
        networks.action_noise(action_key, shape, env.action),
        jax.random.uniform(reset_key, (*shape, env.n_noise)),
    )
    observe = jax.vmap(env.observe, (0, None))
    actor, log_std = state.weights.actor, state.weights.log_std

    def step(carry: tuple[Tree, jax.Array, jax.Array], drawn: Any) -> Any:
        state, elapsed, obs = carry
        outputs = networks.apply(actor, obs)
        action = networks.sample(outputs, log_std, drawn[0], env.action)
        applied = networks.to_environment(action, env.action)
        new, reward, terminated = jax.vmap(env.step, (0, 0, None))(state, applied, params)
        out_of_time = elapsed + 1 >= env.horizon
        done = terminated | out_of_time
        after = observe(new, params)
        start = jax.vmap(env.initial, (0, None))(drawn[1], params)
        state = jax.tree.map(lambda s, n: jnp.where(done, s, n), start, new)
        elapsed = jnp.where(done, 0, elapsed + 1)
        obs_next = observe(state, params)
        if env.time_limit == "terminal":
            terminated = done
        record = Rollout(obs, outputs, action, reward, terminated, done, after)
        return (state, elapsed, obs_next), record

    carry = (state.env, state.elapsed, observe(state.env, params))
    (env_state, elapsed, _), rollout = jax.lax.scan(step, carry, noise)
    return state._replace(env=env_state, elapsed=elapsed, key=key), rollout


def learn_from(env: Environment, recipe: PPORecipe, weights: Weights, rollout: Rollout) -> Batch:
    """(T x E,) transitions with generalised advantages and value targets.

    delta = r + gamma V(after) (1 - terminated) - V(obs); truncated episodes bootstrap from the
    observation in which they were cut off.
    """
    value = networks.apply(weights.critic, rollout.obs)[..., 0]
    value_after = networks.apply(weights.critic, rollout.after)[..., 0]
    reward = rollout.reward.astype(jnp.float32)
    delta = reward + recipe.gamma * jnp.where(rollout.terminated, 0.0, value_after) - value
    decay = jnp.where(rollout.done, 0.0, recipe.gamma * recipe.gae_lambda)

    def back(later: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        advantage = now[0] + now[1] * later
        return advantage, advantage

    _, advantage = jax.lax.scan(
        back, jnp.zeros_like(delta[0]), (delta, decay), reverse=True, unroll=8
    )
    old = networks.log_prob(rollout.outputs, weights.log_std, rollout.action, env.action)
    batch = Batch(rollout.obs, rollout.action, old, advantage, advantage + value)
    return Batch(*(x.reshape(-1, *x.shape[2:]) for x in batch))


def _loss(env: Environment, recipe: PPORecipe, weights: Weights, batch: Batch) -> jax.Array:
    """Clipped surrogate + value_coef x squared error - entropy_coef x entropy."""
    advantage = batch.advantage
    if recipe.normalize_advantage and recipe.batch_size > 1:
        advantage = (advantage - advantage.mean()) / (advantage.std(ddof=1) + 1e-8)
    outputs = networks.apply(weights.actor, batch.obs)
    value = networks.apply(weights.critic, batch.obs)[..., 0]
    log_prob = networks.log_prob(outputs, weights.log_std, batch.action, env.action)
    ratio = jnp.exp(log_prob - batch.log_prob)
    near = jnp.clip(ratio, 1.0 - recipe.clip_range, 1.0 + recipe.clip_range)
    loss = -jnp.minimum(advantage * ratio, advantage * near).mean()
    loss += recipe.value_coef * jnp.square(batch.target - value).mean()
    if recipe.entropy_coef:
        bonus = networks.entropy(outputs, weights.log_std, env.action).mean()
        loss -= recipe.entropy_coef * bonus
    return loss


def _optimizer(recipe: PPORecipe) -> optax.GradientTransformation:
    """Adam after clipping the norm of one policy's gradient; the step is -lr times Adam's."""
    return optax.chain(
        optax.clip_by_global_norm(recipe.max_grad_norm),
        optax.scale_by_adam(eps=recipe.adam_eps),
        optax.scale(-recipe.learning_rate),
    )
