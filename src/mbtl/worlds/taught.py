"""A world whose copies begin their episodes in contexts that a curriculum chooses.

    world = taught(world, curriculum_named("regret"), bounds)

Whoever learns from copies (`copies`) learns in it as in the world itself, which it is otherwise.
After every rollout the episodes that ended in it are counted, and the weights are made anew: by
then as many have ended as an update learns from. Nothing is played for the curriculum alone, so it
costs no environment steps. All that it remembers is part of a training's state.

Which context comes next is no chance: the k-th episode of a training takes the place of the
fractional part of k x 0.618... among the summed weights. Any stretch of episodes has each context
as often as its weight says, up to about one.

Notation (shapes): N contexts, E copies, T steps; of each context M recent episodes are kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mbtl.curricula import Curriculum, Outcomes
from mbtl.errors import InvalidInput
from mbtl.objective import Bounds
from mbtl.worlds.world import Solo, World

RECENT = 10
"""M."""
_GOLDEN = 2654435769
"""2^32 times the golden ratio less 1, rounded to an odd number."""


class Past(NamedTuple):
    """What a training remembers of its episodes.

    Attributes:
        weights: (N,) how often the next ones begin in each context.
        recent: (N, M) returns, the latest first.
        played: (N,) episodes that have ended; the first of `recent` as many are there.
        best: (N,) largest return.
        last: (N,) how many had ended in all when the last one did.
    """

    weights: jax.Array
    recent: jax.Array
    played: jax.Array
    best: jax.Array
    last: jax.Array

    @classmethod
    def empty(cls, n_contexts: int) -> Past:
        """Before the first episode: all contexts alike."""
        nothing = jnp.zeros(n_contexts, jnp.int32)
        return cls(
            jnp.full(n_contexts, 1.0 / n_contexts, jnp.float32),
            jnp.zeros((n_contexts, RECENT), jnp.float32),
            nothing,
            jnp.full(n_contexts, -jnp.inf, jnp.float32),
            nothing,
        )


class Ended(NamedTuple):
    """Of each step and copy, (T, E): whether an episode ended, in which context, its return."""

    done: jax.Array
    context: jax.Array
    score: jax.Array


@dataclass(frozen=True, repr=False, kw_only=True)
class Taught(Solo):
    """`Solo` with a curriculum; make it by `taught`.

    Attributes:
        curriculum: the rule.
        bounds: what performance 0 and 1 mean.
    """

    curriculum: Curriculum
    bounds: Bounds

    def __repr__(self) -> str:
        return f"{self.env!r} taught by {self.curriculum!r} of performance in {self.bounds!r}"

    def after(self, past: Past, ended: Ended) -> Past:
        """What is remembered after a rollout, and the weights for the next."""
        past = remembered(past, ended)
        weights = self.curriculum.weights(self._outcomes(past)).astype(jnp.float32)
        known = (past.played > 0).all()  # first every context once, as levels nobody has seen
        return past._replace(weights=jnp.where(known, weights, 1.0 / len(weights)))

    def _outcomes(self, past: Past) -> Outcomes:
        there = jnp.arange(RECENT) < past.played[:, None]
        count = jnp.maximum(there.sum(axis=1), 1)

        def mean(of_episodes: jax.Array) -> jax.Array:
            return jnp.where(there, of_episodes, 0.0).sum(axis=1) / count

        return Outcomes(
            mean(self._performance(past.recent)),
            self._performance(past.best),
            mean(past.recent >= self.max_return) if self._succeeds else None,
            past.played.sum() - past.last,
        )

    def _performance(self, returns: jax.Array) -> jax.Array:
        low, high = self.bounds
        up = self.bounds.direction == "maximize"
        return (returns - low if up else high - returns) / (high - low)

    @property
    def _succeeds(self) -> bool:
        """Whether an episode can last until time is up, and has the largest return then."""
        return self.max_return is not None and getattr(self.env, "lasts", None) == "return"


def taught(world: World, curriculum: Curriculum, bounds: Bounds) -> Taught:
    """The world with a curriculum.

    Args:
        world: of simulations that start again one by one.
        curriculum: see `mbtl.curricula`.
        bounds: of returns.

    Raises:
        InvalidInput: it has other simulations.
    """
    if not isinstance(world, Solo):
        raise InvalidInput(
            f"a curriculum needs simulations that start again one by one, got "
            f"{type(world).__name__}; train there without one"
        )
    return Taught(world.env, world.agents, world.apart, curriculum=curriculum, bounds=bounds)


def next_contexts(
    weights: jax.Array, context: jax.Array, turn: jax.Array, done: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """(E,) contexts after the copies that are done took new ones, and the number of the next.

    Args:
        weights: (N,) of the contexts.
        context: (E,) so far.
        turn: episodes that have begun, modulo 2^32.
        done: (E,) which copies take a new one; of several, the first goes first.
    """
    taken = jnp.cumsum(done).astype(jnp.uint32)
    place = ((turn + taken - 1) * jnp.uint32(_GOLDEN) >> 8).astype(jnp.float32) / 2.0**24
    edges = jnp.cumsum(weights)[:-1]
    new = (edges <= place[:, None]).sum(axis=1).astype(context.dtype)
    return jnp.where(done, new, context), turn + taken[-1]


def remembered(past: Past, ended: Ended) -> Past:
    """With the episodes that ended; of those of one step, the first copy's counts as the first."""
    n_contexts = len(past.played)
    done, context, score = (x.reshape(-1) for x in ended)
    number = past.played.sum() + jnp.cumsum(done)
    context = jnp.where(done, context, n_contexts)  # out of range: dropped below
    order = jnp.argsort(context, stable=True)  # by context, then by time
    context, score, number = context[order], score[order], number[order]
    count = jnp.zeros_like(past.played).at[context].add(1, mode="drop")
    ends = jnp.append(jnp.cumsum(count), 0)
    later = ends[context] - 1 - jnp.arange(len(context))  # episodes of the same context
    shifted = jnp.arange(RECENT) - count[:, None]
    recent = jnp.take_along_axis(past.recent, jnp.maximum(shifted, 0), axis=1)
    return past._replace(
        recent=recent.at[context, jnp.where(later < 0, RECENT, later)].set(score, mode="drop"),
        played=past.played + count,
        best=past.best.at[context].max(score, mode="drop"),
        last=past.last.at[context].max(number.astype(past.last.dtype), mode="drop"),
    )
