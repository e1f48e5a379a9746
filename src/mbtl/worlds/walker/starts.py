"""How an episode begins: the first two steps of Box2D's walkers, which are looked up.

Their legs are put half a metre too high and pushed out of the ground at once, which joints that
hold exactly cannot do. In the first step, without torque, they get half of the way; what the first
action does is mixed with the rest, and moves a knee by up to half a turn. So a walker in jax is
first seen as Box2D's is after one step, and the state after its first action is looked up among
those that Box2D's walkers had, with every combination of a few strengths of the four motors. A
strength between two of these counts as either, by chance: a state between theirs is none of
Box2D's. A policy that always began in the same state walked from there only, and fell in Box2D.

Gravity and friction add what they change at the nominal scale. Notation (shapes): s values of one
axis, L strengths of a motor.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

FILE = Path(__file__).parent / "starts.npz"
"""`evidence/walker_twin.py --part start --write` wrote it: per axis its values, (s,), and states
after the first action, (s, L**4, 24), of gravity and friction as differences; and per scale what is
seen before it, (s, 7)."""
AXES = ("gravity", "friction", "scale")
_MOTORS = 4
with np.load(FILE) as _file:
    _FOUND: dict[str, NDArray[np.float32]] = {k: _file[k].astype(np.float32) for k in _file.files}
_STRENGTHS = round(len(_FOUND["by_scale"][0]) ** (1.0 / _MOTORS))


class Start(NamedTuple):
    """A walker after its first action.

    Attributes:
        place: (2,) of the hull's origin: from the middle of the flat ground, and above it [m].
        angles: (5,) of the bodies [rad].
        moving: (5, 3) of the bodies: in the first step Box2D's joints do not hold all of it.
        feet: (2,) whether the shins are on the ground.
    """

    place: jax.Array
    angles: jax.Array
    moving: jax.Array
    feet: jax.Array


def made(scale: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Before it: (2,) place of the hull's origin, as in `Start`, and (5,) angles."""
    (low, high), share = _between("scale", scale)
    table = jnp.asarray(_FOUND["made"])
    numbers = table[low] + share * (table[high] - table[low])
    return numbers[:2], numbers[2:]


def after(
    action: jax.Array, luck: jax.Array, gravity: jax.Array, friction: jax.Array, scale: jax.Array
) -> Start:
    """The state after a first action, (4,) within -1..1; luck, (4,) within 0..1, rounds it."""
    at = (action + 1.0) / 2.0 * (_STRENGTHS - 1)
    nearby = jnp.clip(jnp.floor(at + luck), 0, _STRENGTHS - 1).astype(jnp.int32)
    row = nearby @ _STRENGTHS ** np.arange(_MOTORS)[::-1]
    numbers = jnp.zeros(24)
    for axis, value in zip(AXES, (gravity, friction, scale), strict=True):
        (low, high), share = _between(axis, value)
        table = jnp.asarray(_FOUND[f"by_{axis}"])
        numbers = numbers + (1.0 - share) * table[low, row] + share * table[high, row]
    return Start(numbers[:2], numbers[2:7], numbers[7:22].reshape(5, 3), numbers[22:] > 0.5)


def _between(axis: str, value: jax.Array) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
    """Rows of the two nearest values, and how near the second is, 0..1."""
    values = jnp.asarray(_FOUND[axis])
    high = jnp.clip(jnp.searchsorted(values, value), 1, len(_FOUND[axis]) - 1)
    share = (value - values[high - 1]) / (values[high] - values[high - 1])
    return (high - 1, high), jnp.clip(share, 0.0, 1.0)
