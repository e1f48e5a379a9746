"""What an actor-critic does in copies of a world, and what its steps were worth; of PPO and A2C.

Notation (shapes of one policy): T steps, E copies, o observation; the world has one agent.
    obs (T, E, o); action (T, E) or (T, E, d); reward, value, advantage (T, E)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree

from mbtl.engine.learners import networks
from mbtl.engine.learners.networks import Network
from mbtl.engine.learners.recipes import A2CRecipe, PPORecipe, WithCopies
from mbtl.engine.worlds.copies import Copies, first_copies, stepped
from mbtl.engine.worlds.environments import Tree
from mbtl.engine.worlds.world import Solo


class State(NamedTuple):
    """All of one training: with the next `update`'s arguments it decides everything to come.

    Attributes:
        weights: the networks.
        optimizer: what it remembers of all weights as one vector.
        copies: where the policy lives.
        key: its own random key.
        fresh: (2,) whether actor and critic have never learnt; () where nothing depends on it.
        target: of DQN, what `weights.actor` was when it was last copied.
        replay: of DQN, (N, 2 f + 3) ring of transitions: state before, state after, action, reward,
            terminated. Visible features of a context are in it where they change: on several.
    """

    weights: Any
    optimizer: Tree
    copies: Copies
    key: jax.Array
    fresh: Tree = ()
    target: Network | tuple[()] = ()
    replay: Tree = ()


class Noise(NamedTuple):
    """Random numbers of some steps: for the actions, and for the states after a reset."""

    action: jax.Array
    reset: jax.Array


class Rollout(NamedTuple):
    """What T steps of E copies gave; `after` is the observation before a reset."""

    obs: jax.Array
    outputs: jax.Array
    action: jax.Array
    reward: jax.Array
    terminated: jax.Array
    done: jax.Array
    after: jax.Array


Optimizer = Callable[[Any], optax.GradientTransformation]
"""Recipe -> what moves the weights."""


def start(
    optimizer: Optimizer,
    world: Solo,
    recipe: WithCopies,
    seeds: Sequence[int],
    params: Tree,
    weights: Any = None,
) -> State:
    """Networks, an optimiser without memory and freshly started copies of all policies.

    `optimizer` makes what moves them from the recipe, and is a module's function: jax compiles it.
    """
    weights = networks.begun(weights, partial(networks.fresh, world, recipe, seeds, params))
    roots = jnp.asarray(np.array(seeds, dtype=np.uint32))
    return cast(State, _start(world, recipe, optimizer, weights, roots, params))


@partial(jax.jit, static_argnums=(0, 1, 2))
@partial(jax.vmap, in_axes=(None, None, None, 0, 0, 0))
def _start(
    world: Solo,
    recipe: WithCopies,
    optimizer: Optimizer,
    weights: Any,
    seed: jax.Array,
    params: Tree,
) -> State:
    moments = optimizer(recipe).init(ravel_pytree(weights)[0])
    return State(weights, moments, *first_copies(world, recipe.n_envs, seed, params))


def draw(world: Solo, key: jax.Array, shape: tuple[int, ...]) -> tuple[jax.Array, Noise]:
    """The next key, and noise for steps of this shape, e.g. (T, E)."""
    key, action_key, reset_key = jax.random.split(key, 3)
    noise = Noise(
        networks.action_noise(action_key, shape, world.action), world.noise(reset_key, shape)
    )
    return key, noise


def play(
    world: Solo, recipe: PPORecipe | A2CRecipe, state: State, params: Tree, noise: Noise
) -> tuple[State, Rollout]:
    """T steps of the E copies with sampled actions, from (T, E) noise; the key stays."""
    actor, log_std = state.weights.actor, state.weights.log_std

    def act(obs: jax.Array, drawn: jax.Array) -> tuple[jax.Array, Tree]:
        outputs = networks.apply(actor, obs, recipe.activation)
        action = networks.sample(outputs, log_std, drawn, world.action)
        return networks.to_environment(action, world.action), (outputs, action)

    copies, obs, (outputs, action), step = stepped(world, params, state.copies, act, *noise)
    return state._replace(copies=copies), Rollout(obs, outputs, action, *step)


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
