"""What the signal twin knows of intersections; notation as in `mbtl.worlds.traffic.crossing`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mbtl.worlds.traffic import lane


class CrossingParams(NamedTuple):
    """One context, or one per simulation.

    Attributes:
        length: of every approach [m].
        inflow: cars of an episode.
        speed: limit on the roads [m/s].
        crowded: mode of demand, see `crossing_demand.departures`; -1: as it comes.
        visible: (v,) or (n, v) features appended to each observation.
    """

    length: jax.Array
    inflow: jax.Array
    speed: jax.Array
    crowded: jax.Array
    visible: jax.Array


@dataclass(frozen=True)
class Turn:
    """What a car does in the box.

    Attributes:
        speed: limit there [m/s].
        metres: its way through it.
    """

    speed: float
    metres: float


class Queues(NamedTuple):
    """The cars of all lanes, (rows, 16, n); row 0 is the foremost one.

    Attributes:
        x: front [m]; `lane.EMPTY`: there is no car.
        v: [m/s].
        waited: seconds for which a car has stood on its way.
        right: 1 if it turns right, else 0.
    """

    x: jax.Array
    v: jax.Array
    waited: jax.Array
    right: jax.Array


class Totals(NamedTuple):
    """Sums over the decisions of an episode, (n,).

    Attributes:
        waiting: of the seconds for which cars on the approaches had stood.
        queue: cars that stood.
        speed: of the cars on the approaches [m/s].
        cars: on the approaches.
        decisions: so many.
        lost: seconds that cars on the approaches lost, see `CrossingTwin.score`, and those that
            cars waited before they entered.
    """

    waiting: jax.Array
    queue: jax.Array
    speed: jax.Array
    cars: jax.Array
    decisions: jax.Array
    lost: jax.Array


class CrossingState(NamedTuple):
    """n intersections.

    Attributes:
        queues: the cars.
        plan: (K, 16, n) who comes, see `crossing_demand.plan`.
        entered: (16, n) cars of each lane that have come so far.
        phase: (n,) that has green; -1: none had so far.
        held: (n,) decisions for which it has had it.
        time: (n,) seconds since the beginning.
        waiting: (n,) what was added to `totals.waiting` last.
        totals: over the decisions so far.
        cells: (n, 80) what was seen last.
        seed: (n,) uint32.
        steps: decisions since the beginning, of all.
    """

    queues: Queues
    plan: jax.Array
    entered: jax.Array
    phase: jax.Array
    held: jax.Array
    time: jax.Array
    waiting: jax.Array
    totals: Totals
    cells: jax.Array
    seed: jax.Array
    steps: jax.Array


VACANT = Queues(lane.EMPTY, 0.0, 0.0, 0.0)
"""Fields of an empty row."""


def there(x: jax.Array) -> jax.Array:
    """Whether a row holds a car."""
    return x > 0.5 * lane.EMPTY


def moved_up(queues: Queues, most: int) -> Queues:
    """Without the empty rows before the foremost car of each lane, of which there are so many."""
    rows = len(queues.x)
    first = jnp.where(there(queues.x), jnp.arange(rows)[:, None, None], rows).min(axis=0)
    gone = jnp.where(first < rows, first, 0)

    def by(step: int, field: jax.Array, nobody: float) -> jax.Array:
        if step >= rows:
            return field
        tail = jnp.full((step, *field.shape[1:]), nobody)
        return jnp.where(gone & step > 0, jnp.concatenate([field[step:], tail]), field)

    for bit in range(most.bit_length()):
        fields = zip(queues, VACANT, strict=True)
        queues = Queues(*(by(1 << bit, field, nobody) for field, nobody in fields))
    return queues
