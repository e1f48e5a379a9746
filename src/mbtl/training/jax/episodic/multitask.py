"""One policy for all contexts of a twin: each episode of an update is in another of them.

They are drawn uniformly, without repetition while there are any. Episodes are lived through one by
one, so the twin need not mix contexts; those with about as many decisions share a compiled program.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mbtl.training.jax.blocks import Block, Schedule, Training, in_blocks
from mbtl.training.jax.episodic.episodes import (
    Acting,
    Episodes,
    actor_of,
    delayed,
    joined,
    record,
    scores,
)
from mbtl.training.jax.episodic.learning import State, episode_seeds, learnt
from mbtl.training.jax.episodic.recipes import TwinRecipe
from mbtl.training.jax.loop import checkpoint_seeds, judged, start
from mbtl.training.jax.recipes import Activation, check_lengths
from mbtl.worlds import random
from mbtl.worlds.environments import Tree
from mbtl.worlds.world import World

_CONTEXT = 1 << 22  # stream of random numbers: the contexts of updates


def train_on_all(
    twin: World,
    recipe: TwinRecipe,
    seed: int,
    contexts: Sequence[Tree],
    episodes: int,
    *,
    checkpoints: int,
    checkpoint_episodes: int,
    acting: Acting = "sampled",
    on_block: Callable[[Block], None] | None = None,
    resume: Training | None = None,
) -> Training:
    """Train one policy on N contexts.

    Args:
        twin: the dynamics.
        recipe: hyper-parameters; `n_episodes` contexts are met in an update.
        seed: training seed of 32 bits.
        contexts: N >= 1 parameters, each of one context.
        episodes: over all contexts together, rounded up to whole updates.
        checkpoints: evaluations, each on all contexts.
        checkpoint_episodes: per context of an evaluation, the same at every one.
        acting: how actions are chosen there.
        on_block: called after each of them, with episodes as steps.
        resume: what an interrupted call had reached (given again with the same arguments).

    Returns:
        Final and best weights, best on the mean over all contexts.

    Raises:
        InvalidInput: a number is below 1.
        TrainingFailed: weights are no longer finite.
    """
    check_lengths(
        episodes=episodes, checkpoints=checkpoints, checkpoint_episodes=checkpoint_episodes
    )
    lasting = [cast(int, twin.decisions(one)) for one in contexts]  # one by one: no beats
    most = [max(d for d in lasting if d.bit_length() == own.bit_length()) for own in lasting]
    tests = checkpoint_seeds([seed], checkpoint_episodes)

    def advance(training: Training, count: int) -> tuple[Training, jax.Array]:
        for number in range(int(training.updates), int(training.updates) + count):
            met = _drawn(seed, number, len(contexts), recipe.n_episodes)
            seeds = _seeds(recipe, training.state, training.updates)
            lived = [
                _lived(
                    twin, recipe.activation, recipe.hold, most[i], max(lasting), training.state,
                    seeds[:, [k]], contexts[i], jnp.int32(lasting[i]),
                )
                for k, i in enumerate(met.tolist())
            ]  # fmt: skip
            training = _updated(twin, recipe, training, lived)
        actor = actor_of(training.state.weights)
        found = [
            scores(twin, recipe.activation, acting, actor, tests, tests, one, decisions).mean(
                axis=1
            )
            for one, decisions in zip(contexts, lasting, strict=True)
        ]
        return judged(training, jnp.stack(found).mean(axis=0))

    training = start(twin, recipe, [seed], contexts[0]) if resume is None else resume
    schedule = Schedule.of(episodes, recipe.n_episodes, math.ceil(episodes / checkpoints))
    return in_blocks(schedule, training, advance, on_block)


def _drawn(seed: int, number: int, contexts: int, count: int) -> NDArray[np.int64]:
    """(count,) contexts of the episodes of an update."""
    rounds = math.ceil(count / contexts)
    own, moment = jnp.array([seed], jnp.uint32), jnp.uint32(number)
    draw = np.asarray(random.bits(own, _CONTEXT, moment, rounds * contexts))
    return draw.reshape(rounds, contexts).argsort(axis=1).reshape(-1)[:count]


_seeds = jax.jit(episode_seeds, static_argnums=0)


@partial(jax.jit, static_argnums=(0, 1, 2, 3, 4))
def _lived(
    twin: World,
    activation: Activation,
    hold: int,
    most: int,
    longest: int,
    state: State,
    seeds: jax.Array,
    params: Tree,
    lasting: jax.Array,
) -> Episodes:
    """Episodes of `lasting` decisions, `most` at most, as if there were `longest`."""
    actor = actor_of(state.weights)
    lived = record(twin, activation, most, actor, seeds, params, lasting, hold)
    return delayed(lived, longest - most)


@partial(jax.jit, static_argnums=(0, 1), donate_argnums=2)
def _updated(
    twin: World, recipe: TwinRecipe, training: Training, lived: list[Episodes]
) -> Training:
    """One update with an episode of each of the contexts met."""
    state = learnt(twin, recipe, training.state, training.updates, joined(lived))
    return training._replace(state=state, updates=training.updates + 1)
