"""Copies of a world that start again one by one, and what an actor-critic's steps were worth there.

PPO and A2C share it. With N contexts copies take turns: one queue for all, and whenever an episode
ends, its copy starts the next context, 0, 1, ..., N - 1, 0, ...; of copies that end in the same
step, the first goes first. So at any time no context has been started more than once more often
than another, however long its episodes are and however many copies there are (cmdp-spec, 8.3).

Notation (shapes of one policy): T steps, E copies, o observation; the world has one agent.
    obs (T, E, o); action (T, E) or (T, E, d); reward, value, advantage (T, E)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree

from mbtl.training.jax import networks
from mbtl.training.jax.networks import Network
from mbtl.training.jax.recipes import A2CRecipe, ActorCritic, PPORecipe, WithCopies
from mbtl.worlds.environments import Tree
from mbtl.worlds.world import Solo


class Copies(NamedTuple):
    """E simulations of one policy: their states, and (E,) steps since each was started.

    Of N contexts: in which each is, (E,), and in which the next one starts; None where N = 1.
    """

    world: Tree
    elapsed: jax.Array
    context: jax.Array | None
    turn: jax.Array | None


class State(NamedTuple):
    """All of one training: with the next `update`'s arguments it decides everything to come.

    Attributes:
        weights: the networks, with attributes `actor`, `critic` and `log_std`.
        optimizer: what the optimiser remembers, over all weights as one vector.
        copies: where the policy lives.
        key: the policy's own random key.
    """

    weights: Any
    optimizer: Tree
    copies: Copies
    key: jax.Array


class Noise(NamedTuple):
    """Random numbers of some steps: for the actions, and for the states after a reset."""

    action: jax.Array
    reset: jax.Array


class Step(NamedTuple):
    """What a step of E copies gave; `after` is the observation before a reset."""

    reward: jax.Array
    terminated: jax.Array
    done: jax.Array
    after: jax.Array


class Rollout(NamedTuple):
    """What T steps of E copies gave; `after` is the observation before a reset."""

    obs: jax.Array
    outputs: jax.Array
    action: jax.Array
    reward: jax.Array
    terminated: jax.Array
    done: jax.Array
    after: jax.Array


def start(
    optimizer: Callable[[Any], optax.GradientTransformation],
    world: Solo,
    recipe: WithCopies,
    seeds: Sequence[int],
    params: Tree,
    weights: Any = None,
) -> State:
    """Networks, an optimiser without memory and freshly started copies of all policies.

    Fresh networks are for actor-critics; `optimizer` makes what moves them from the recipe, and is
    a module's function, since jax compiles it in.
    """
    if weights is None:
        assert isinstance(recipe, ActorCritic)
        weights = networks.stack(networks.fresh(world, recipe, seeds, params))
    roots = jnp.asarray(np.array(seeds, dtype=np.uint32))
    state: State = _start(world, recipe, optimizer, weights, roots, params)
    return state


@partial(jax.jit, static_argnums=(0, 1, 2))
@partial(jax.vmap, in_axes=(None, None, None, 0, 0, 0))
def _start(
    world: Solo,
    recipe: WithCopies,
    optimizer: Callable[[Any], optax.GradientTransformation],
    weights: Any,
    seed: jax.Array,
    params: Tree,
) -> State:
    moments = optimizer(recipe).init(ravel_pytree(weights)[0])
    return State(weights, moments, *first_copies(world, recipe.n_envs, seed, params))


def first_copies(
    world: Solo, n_envs: int, seed: jax.Array, params: Tree
) -> tuple[Copies, jax.Array]:
    """Freshly started copies, and the key of what follows."""
    key, reset_key = jax.random.split(jax.random.PRNGKey(seed))
    noise = world.noise(reset_key, (n_envs,))
    context = turn = None
    if params.visible.ndim == 2:
        n_contexts = params.visible.shape[0]
        context, turn = jnp.arange(n_envs) % n_contexts, jnp.int32(n_envs % n_contexts)
    states = world.start(noise, _own(params, context))
    return Copies(states, jnp.zeros(n_envs, dtype=jnp.int32), context, turn), key


def draw(world: Solo, key: jax.Array, shape: tuple[int, ...]) -> tuple[jax.Array, Noise]:
    """The next key, and noise for steps of this shape, e.g. (T, E)."""
    key, action_key, reset_key = jax.random.split(key, 3)
    noise = Noise(
        networks.action_noise(action_key, shape, world.action), world.noise(reset_key, shape)
    )
    return key, noise


def advance(
    world: Solo, params: Tree, copies: Copies, action: jax.Array, noise: jax.Array
) -> tuple[Copies, Step]:
    """One step of the E copies; one that has ended starts anew from its noise."""
    own = _own(params, copies.context)
    moved = world.step(copies.world, action[:, None], own)
    terminated = moved.done[:, 0]
    done = terminated | (copies.elapsed + 1 >= world.decisions(params))
    after = world.observe(moved.state, own).obs[:, 0]
    context, turn = copies.context, copies.turn
    if context is not None and turn is not None:
        context, turn = take_turns(context, turn, done, params.visible.shape[0])
    state = world.restart(moved.state, done, noise, _own(params, context))
    elapsed = jnp.where(done, 0, copies.elapsed + 1)
    if world.time_limit == "terminal":
        terminated = done
    return Copies(state, elapsed, context, turn), Step(moved.reward[:, 0], terminated, done, after)


def look(world: Solo, params: Tree, copies: Copies) -> jax.Array:
    """(E, o) what the agents see."""
    return world.observe(copies.world, _own(params, copies.context)).obs[:, 0]


def take_turns(
    context: jax.Array, turn: jax.Array, done: jax.Array, n_contexts: int
) -> tuple[jax.Array, jax.Array]:
    """(E,) contexts after the copies that are done took the next ones, and whose turn is next."""
    taken = jnp.cumsum(done)
    context = jnp.where(done, (turn + taken - 1) % n_contexts, context)
    return context, (turn + taken[-1]) % n_contexts


def play(
    world: Solo, recipe: PPORecipe | A2CRecipe, state: State, params: Tree, noise: Noise
) -> tuple[State, Rollout]:
    """T steps of the E copies with sampled actions, from (T, E) noise; the key stays."""
    actor, log_std = state.weights.actor, state.weights.log_std

    def step(carry: tuple[Copies, jax.Array], drawn: Noise) -> Any:
        copies, obs = carry
        outputs = networks.apply(actor, obs, recipe.activation)
        action = networks.sample(outputs, log_std, drawn.action, world.action)
        applied = networks.to_environment(action, world.action)
        copies, step = advance(world, params, copies, applied, drawn.reset)
        return (copies, look(world, params, copies)), Rollout(obs, outputs, action, *step)

    (copies, _), rollout = jax.lax.scan(
        step, (state.copies, look(world, params, state.copies)), noise
    )
    return state._replace(copies=copies), rollout


def _own(params: Tree, context: jax.Array | None) -> Tree:
    """Parameters of the context of each copy, or of one context for all."""
    return params if context is None else jax.tree.map(lambda x: x[context], params)


def advantages(
    recipe: PPORecipe | A2CRecipe, critic: Network, rollout: Rollout, value: jax.Array
) -> jax.Array:
    """(T, E) generalised advantage estimates, given `value`, the critic's of the observations.

    delta = r + gamma V(after) (1 - terminated) - V(obs); truncated episodes bootstrap from the
    observation in which they were cut off.
    """
    value_after = networks.apply(critic, rollout.after, recipe.activation)[..., 0]
    reward = rollout.reward.astype(jnp.float32)
    delta = reward + recipe.gamma * jnp.where(rollout.terminated, 0.0, value_after) - value
    decay = jnp.where(rollout.done, 0.0, recipe.gamma * recipe.gae_lambda)

    def back(later: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        advantage = now[0] + now[1] * later
        return advantage, advantage

    _, advantage = jax.lax.scan(
        back, jnp.zeros_like(delta[0]), (delta, decay), reverse=True, unroll=8
    )
    return advantage
