"""One policy for all contexts of a twin: the episodes of each update are in one of them.

Which one is drawn uniformly, update by update, so the twin need not mix contexts. Those of episodes
with about as many decisions share a compiled program.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.seeds import Purpose, derive_seed
from mbtl.training.jax.environments import Tree
from mbtl.training.jax.loop import Block, Training
from mbtl.training.jax.recipes import check_lengths
from mbtl.training.jax.traffic import random
from mbtl.training.jax.traffic.episodes import Acting, Actor, scores
from mbtl.training.jax.traffic.learning import in_blocks, start, update
from mbtl.training.jax.traffic.recipes import TwinRecipe
from mbtl.training.jax.traffic.twin import Twin

_CONTEXT = 1 << 22  # stream of random numbers: the contexts of updates


def train_on_all(
    twin: Twin,
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
        recipe: hyper-parameters; `n_episodes` are played in the one context of an update.
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
    lasting = [twin.decisions(one) for one in contexts]
    most = [max(d for d in lasting if d.bit_length() == own.bit_length()) for own in lasting]
    numbers = range(checkpoint_episodes)
    tests = np.array([[derive_seed(seed, Purpose.CHECKPOINT, e) for e in numbers]], np.uint32)
    total = math.ceil(episodes / recipe.n_episodes)
    own = jnp.array([seed], jnp.uint32)
    drawn = np.asarray(random.bits(own, _CONTEXT, jnp.uint32(0), total))[:, 0] % len(contexts)

    def learn(training: Training, count: int) -> Training:
        done = int(training.updates)
        for i in drawn[done : done + count]:
            training = _updated(twin, recipe, most[i], training, contexts[i], jnp.int32(lasting[i]))
        return training

    def judge(actor: Actor) -> jax.Array:
        found = [
            scores(twin, recipe.activation, acting, actor, tests, one, decisions).mean(axis=1)
            for one, decisions in zip(contexts, lasting, strict=True)
        ]
        return jnp.stack(found).mean(axis=0)

    training = start(twin, recipe, [seed], contexts[0]) if resume is None else resume
    lengths = episodes, math.ceil(episodes / checkpoints)
    return in_blocks(recipe, training, lengths, learn, judge, on_block)


@partial(jax.jit, static_argnums=(0, 1, 2), donate_argnums=3)
def _updated(
    twin: Twin,
    recipe: TwinRecipe,
    most: int,
    training: Training,
    params: Tree,
    lasting: jax.Array,
) -> Training:
    """One update on a context whose episodes have `lasting` decisions, `most` at most."""
    state = update(twin, recipe, most, training.state, training.updates, params, lasting)
    return training._replace(state=state, updates=training.updates + 1)
