"""Episodes of contexts whose decisions last differently long, lived through together.

All simulations move in beats, of which every decision is a multiple, so that none waits for
another; who has no decision due keeps its instruction. What was recorded by beat is then put in the
order of decisions. Episodes of few decisions end with the others and begin later: before their
first decision nobody acts, and as advantages run from the end to the beginning, that is no delay.

Notation (shapes): n simulations, D decisions of the longest episode, B beats.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.engine.worlds.environments import Beats, Length, Tree
from mbtl.engine.worlds.world import Seeded, World

_ALIKE = 4
"""So many times as many decisions as in another episode are too many to learn from together."""

Decide = Callable[[Tree, jax.Array], tuple[jax.Array, Tree]]
"""state, (n,) numbers of decisions -> (n, ...) actions to apply, and what shall be kept of it."""


class HoldParams(NamedTuple):
    """One context, or one per simulation, in which every instruction is held for the same time.

    Attributes:
        hold: simulation steps of one decision; a scalar or (n,).
        visible: (v,) or (n, v) features appended to each observation.
    """

    hold: jax.Array
    visible: jax.Array


class Holds(Seeded):
    """What worlds with `HoldParams` have in common; their batches move in beats.

    A beat is a time of which all decisions are multiples. Between decisions an instruction holds.
    A subclass has two methods more:

        held(state) -> held                 instructions before the first beat
        beat(state, held, action, params, beats, now) -> (Moved, held)
            one beat; instructions are taken where a decision is due. `Moved` tells reward and end
            of a decision with its last beat. Whose episode is over stands still.

    Attributes:
        total_steps: of the time in which there are decisions; the last may go beyond.
    """

    total_steps: int

    def decisions(self, params: HoldParams) -> Length:
        """Enough holds to fill that time."""
        holds = np.atleast_1d(np.asarray(params.hold))
        counts = -(-self.total_steps // holds)
        if params.hold.ndim == 0:
            return int(counts[0])
        steps = int(np.gcd.reduce(holds))
        return Beats(int(counts.max()), int((counts * holds).max()) // steps, steps)

    def groups(self, params: HoldParams, most: int) -> list[int]:
        """Sizes of groups of consecutive contexts, at most so many in each, to train together.

        All policies of a program learn from as many rows as the one with the most decisions, so no
        episode of a group has more than `_ALIKE` times the decisions of another.
        """
        sizes: list[int] = []
        group: list[float] = []  # the holds of the last one
        for hold in np.atleast_1d(np.asarray(params.hold)).tolist():
            wider = [*group, hold]
            if group and len(group) < most and max(wider) <= _ALIKE * min(wider):
                group, sizes[-1] = wider, len(wider)
            else:
                group = [hold]
                sizes.append(1)
        return sizes

    def beats(self, params: HoldParams, beats: Beats) -> tuple[jax.Array, jax.Array]:
        """(n,) beats of one decision, and decisions of an episode."""
        return params.hold // beats.steps, -(-self.total_steps // params.hold)


class Decisions(NamedTuple):
    """What was lived through, (D, n, ...).

    Attributes:
        kept: by `Decide`.
        due: there was a decision; not before the first of an episode.
        reward: until the next decision, (D, n, A).
        done: a life ended then, (D, n, A).
    """

    kept: Tree
    due: jax.Array
    reward: jax.Array
    done: jax.Array


def lived(
    twin: World, length: Length, state: Tree, params: Tree, decide: Decide
) -> tuple[Tree, Decisions]:
    """The state after the longest episode, and what happened on the way.

    Args:
        twin: the dynamics; in beats one of `Holds`.
        length: of the longest episode, in decisions that last equally long or in beats; static.
        state: at the first decision.
        params: of every simulation.
        decide: what agents are told.
    """
    if isinstance(length, Beats):
        return _in_beats(twin, length, state, params, decide)

    def one(state: Tree, number: jax.Array) -> tuple[Tree, Decisions]:
        action, kept = decide(state, number)
        moved = twin.step(state, action, params)
        return moved.state, Decisions(kept, jnp.ones(len(action), bool), moved.reward, moved.done)

    state, found = jax.lax.scan(one, state, jnp.arange(length, dtype=jnp.uint32))
    return state, found


def _in_beats(
    twin: Any, beats: Beats, state: Tree, params: Tree, decide: Decide
) -> tuple[Tree, Decisions]:
    every, decisions = twin.beats(params, beats)

    def one(carry: tuple[Tree, Tree], now: jax.Array) -> tuple[tuple[Tree, Tree], Any]:
        state, held = carry
        action, kept = decide(state, now // every)
        moved, held = twin.beat(state, held, action, params, beats, now)
        return (moved.state, held), (kept, moved.reward, moved.done)

    first = (state, twin.held(state))
    (state, _), (kept, reward, done) = jax.lax.scan(one, first, jnp.arange(beats.total))
    number = jnp.arange(beats.decisions)[:, None] - (beats.decisions - decisions)  # (D, n)
    begins = jnp.maximum(number, 0) * every
    ends, own = begins + every - 1, jnp.arange(len(every))
    return state, Decisions(
        jax.tree.map(lambda x: x[begins, own], kept),
        number >= 0,
        reward[ends, own],
        done[ends, own] & (number >= 0)[..., None],
    )


def played(
    twin: World, length: Length, state: Tree, params: Tree, told: Callable[[Tree, jax.Array], Any]
) -> Tree:
    """The state after the longest episode, of which nothing is kept.

    It ends as soon as all episodes have, or after the last beat. The numbers of `length` may be
    traced. `told`: state, number of the decision -> actions, or None where nobody advises.
    """
    if isinstance(length, Beats):
        return _beaten(twin, length, state, params, told)

    def going_on(carry: tuple[jax.Array, Tree]) -> jax.Array:
        return (carry[0] < length) & ~twin.over(carry[1]).all()

    def one(carry: tuple[jax.Array, Tree]) -> tuple[jax.Array, Tree]:
        number, state = carry
        action = told(state, number)
        moved = twin.drive(state, params) if action is None else twin.step(state, action, params)
        return number + 1, moved.state

    return jax.lax.while_loop(going_on, one, (jnp.int32(0), state))[1]


def _beaten(
    twin: Any, beats: Beats, state: Tree, params: Tree, told: Callable[[Tree, jax.Array], Any]
) -> Tree:
    every, _ = twin.beats(params, beats)

    def one(now: jax.Array, carry: tuple[Tree, Tree]) -> tuple[Tree, Tree]:
        state, held = carry
        moved, held = twin.beat(state, held, told(state, now // every), params, beats, now)
        return moved.state, held

    return jax.lax.fori_loop(0, beats.total, one, (state, twin.held(state)))[0]
