"""Deep Q-learning of one policy, written to be vectorised over many with `jax.vmap`.

State in, state out. Semantics are those of Stable-Baselines3: epsilon-greedy steps into a ring of
transitions, Huber loss towards a target network that is copied now and then, and truncated episodes
that bootstrap. All policies are at the same step, so they share what only the step decides, the
place of new transitions in the ring and which of the old ones a minibatch takes: the ring is then
written by one slice and read by one gather of whole rows, whatever its size.

Notation (shapes of one policy): R rounds per update, T steps per round, E environment copies,
G gradient steps per round, B minibatch, N transitions in the ring, f numbers of an observation that
change: features of the state, and of the context where a policy learns from several.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from mbtl.engine.learners import networks
from mbtl.engine.learners.blocks import copied
from mbtl.engine.learners.clock import Clock
from mbtl.engine.learners.descent import adam, descended
from mbtl.engine.learners.networks import Network
from mbtl.engine.learners.recipes import AnyDQN, DQNRecipe
from mbtl.engine.learners.rollout import State, start
from mbtl.engine.worlds.copies import stepped
from mbtl.engine.worlds.environments import Tree
from mbtl.engine.worlds.world import Solo


class Batch(NamedTuple):
    """Transitions to learn from, one leading axis."""

    obs: jax.Array
    after: jax.Array
    action: jax.Array
    reward: jax.Array
    terminated: jax.Array


class Round(NamedTuple):
    """What one round is given: steps done before it, and uniform random numbers.

    A coin for each action, (T, E), what resets need, (T, E, n_noise), and the minibatch, (G, B).
    """

    step: jax.Array
    coin: jax.Array
    reset: jax.Array
    pick: jax.Array


def init(
    world: Solo, recipe: DQNRecipe, seeds: Sequence[int], params: Tree, weights: Any = None
) -> State:
    """As `rollout.start`, with empty rings; the weights to begin from are the first target, too.

    Raises:
        InvalidInput: actions are not discrete.
    """
    begun = start(adam, world, recipe, seeds, params, weights)
    target = copied(begun.weights.actor)
    changing = params.visible.shape[-1] if params.visible.ndim == 3 else 0
    width = 2 * (world.n_features + changing) + 3
    replay = jnp.zeros((len(seeds), recipe.buffer_size, width))
    return begun._replace(target=target, replay=replay)


def update(world: Solo, recipe: DQNRecipe, state: State, params: Tree, clock: Clock) -> State:
    """`recipe.rounds_per_update` rounds of some steps and some gradient steps.

    The clock decides epsilon, the places in the ring, when the target is copied, and by its key
    which transitions are learnt from.
    """
    n_rounds, per_round = recipe.rounds_per_update, recipe.steps_per_round
    shape = (n_rounds, recipe.train_freq, recipe.n_envs)
    key, coin_key, reset_key = jax.random.split(state.key, 3)
    rounds = Round(
        clock.number * recipe.update_length + per_round * jnp.arange(n_rounds),
        jax.random.uniform(coin_key, shape),
        world.noise(reset_key, shape),
        jax.random.uniform(clock.key, (n_rounds, recipe.gradient_steps, recipe.batch_size)),
    )
    rate, pace = clock.rate, clock.pace
    # a tuned copy goes on exploring where its parent was, with a ring of its own
    time = pace.before * recipe.update_length, pace.whole * recipe.update_length

    def one(state: State, now: Round) -> tuple[State, None]:
        state, rows = explore(world, recipe, state, params, now, time)
        replay = jax.lax.dynamic_update_slice(
            state.replay, rows, (now.step % recipe.buffer_size, 0)
        )
        step = now.step + per_round
        copy = step // recipe.target_every > now.step // recipe.target_every
        target = jax.tree.map(partial(jnp.where, copy), state.weights.actor, state.target)
        filled = jnp.minimum(step, recipe.buffer_size)
        picked = replay[jnp.floor(now.pick * filled).astype(jnp.int32)]
        network, moments = jax.lax.cond(
            step > recipe.learning_starts,
            partial(learn, recipe, rate, params.visible),
            lambda network, moments, *_: (network, moments),
            *(state.weights.actor, state.optimizer, target, picked),
        )
        weights = state.weights._replace(actor=network)
        return state._replace(
            weights=weights, target=target, optimizer=moments, replay=replay
        ), None

    state, _ = jax.lax.scan(one, state._replace(key=key), rounds)
    return state


def epsilon(
    recipe: DQNRecipe, step: jax.Array, total: jax.Array, before: jax.Array | int = 0
) -> jax.Array:
    """Probability of a random action at environment step `step`, after `before`, of `total`."""
    falling = fallen(recipe, (before + step) / (recipe.exploration_fraction * total))
    return jnp.where(step < recipe.learning_starts, 1.0, falling)


def fallen(recipe: AnyDQN, share: jax.Array) -> jax.Array:
    """Probability of a random action after a share of the time in which it falls."""
    return 1.0 + jnp.minimum(share, 1.0) * (recipe.final_epsilon - 1.0)


def explore(
    world: Solo,
    recipe: DQNRecipe,
    state: State,
    params: Tree,
    now: Round,
    time: tuple[jax.Array | int, jax.Array],
) -> tuple[State, jax.Array]:
    """T epsilon-greedy steps of the E copies, and their (T x E, 2 f + 3) rows of the ring.

    The time is that of the trainings before, and that of a whole one, in environment steps.
    """
    network, n, (before, total) = state.weights.actor, networks.options(world), time
    f = (state.replay.shape[-1] - 3) // 2

    def act(obs: jax.Array, drawn: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        t, coin = drawn
        chance = epsilon(recipe, now.step + t * recipe.n_envs, total, before)
        random = jnp.minimum((coin / chance * n).astype(jnp.int32), n - 1)
        greedy = jnp.argmax(networks.apply(network, obs, recipe.activation), axis=-1)
        action = jnp.where(coin < chance, random, greedy)
        return action, action

    drawn = (jnp.arange(recipe.train_freq), now.coin)
    copies, obs, action, step = stepped(world, params, state.copies, act, drawn, now.reset)
    scalars = jnp.stack([action, step.reward, step.terminated], axis=-1)
    rows = jnp.concatenate([obs[..., :f], step.after[..., :f], scalars], axis=-1)
    return state._replace(copies=copies), rows.reshape(recipe.steps_per_round, -1)


def learn(
    recipe: DQNRecipe,
    scale: jax.Array,
    visible: jax.Array,
    network: Network,
    moments: Tree,
    target: Network,
    rows: jax.Array,
) -> tuple[Network, Tree]:
    """G gradient steps, `scale` times the recipe's learning rate, on (G, B, 2 f + 3) rows."""

    def one(carry: tuple[Network, Tree], rows: jax.Array) -> tuple[tuple[Network, Tree], None]:
        return descend(recipe, target, unpack(rows, visible), scale, *carry), None

    (network, moments), _ = jax.lax.scan(one, (network, moments), rows)
    return network, moments


def descend(
    recipe: AnyDQN, target: Network, batch: Batch, scale: jax.Array, network: Network, moments: Tree
) -> tuple[Network, Tree]:
    """One gradient step, `scale` times the recipe's learning rate.

    Towards r + gamma max_a Q_target(after, a) (1 - terminated), (B,).
    """
    ahead = networks.apply(target, batch.after, recipe.activation).max(axis=-1)
    goals = batch.reward + recipe.gamma * (1.0 - batch.terminated) * ahead
    gradient = jax.grad(loss, argnums=1)(recipe, network, batch, goals)
    return descended(adam(recipe), network, gradient, moments, scale)


def unpack(rows: jax.Array, visible: jax.Array) -> Batch:
    """Rows of the ring as transitions, with the (v,) visible features back in the observations.

    Those of several contexts, (n, v), are there already.
    """
    batch = unpacked(rows)
    if visible.ndim == 2:
        return batch
    shown = jnp.broadcast_to(visible, (len(rows), *visible.shape))
    return batch._replace(
        obs=jnp.concatenate([batch.obs, shown], axis=-1),
        after=jnp.concatenate([batch.after, shown], axis=-1),
    )


def unpacked(rows: jax.Array) -> Batch:
    """(B, 2 f + 3) rows of the ring as transitions."""
    f = (rows.shape[-1] - 3) // 2
    return Batch(rows[:, :f], rows[:, f : 2 * f], *(rows[:, 2 * f + k] for k in range(3)))


def loss(recipe: AnyDQN, network: Network, batch: Batch, goals: jax.Array) -> jax.Array:
    """Mean Huber loss, quadratic up to an error of 1, of the values of the actions taken."""
    values = networks.apply(network, batch.obs, recipe.activation)
    # a sum over a mask, not a gather: gathers with batched indices are slow on a CPU
    taken = batch.action[:, None] == jnp.arange(values.shape[-1])
    value = jnp.where(taken, values, 0.0).sum(axis=-1)
    return optax.losses.huber_loss(value, goals).mean()
