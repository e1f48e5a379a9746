"""How an episode begins: the first two steps of Box2D's walkers, which are looked up.

Their legs are put half a metre too high and pushed out of the ground at once, which joints that
hold exactly cannot do. In the first step, without torque, they get half of the way; what the first
action does is mixed with the rest, and moves a knee by up to half a turn. So a walker in jax is
first seen as Box2D's is after one step, and the state after its first action is looked up among
those that Box2D's walkers had, with every combination of a few strengths of the four motors, and
between them by straight lines. A policy that always began in the same state walked from there only,
and fell in Box2D.

Gravity and friction add what they change at the nominal scale. Notation (shapes): s values of one
axis, L strengths of a motor.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

FILE = Path(__file__).parent / "starts.npz"
"""`evidence/walker_twin.py --part start --write` wrote it: per axis its values, (s,), and states
after the first action, (s, L**4, 16), of gravity and friction as differences; and per scale what is
seen before it, (s, 7)."""
AXES = ("gravity", "friction", "scale")
_MOTORS = 4
with np.load(FILE) as _file:
    _FOUND: dict[str, NDArray[np.float32]] = {k: _file[k].astype(np.float32) for k in _file.files}
_STRENGTHS = round(len(_FOUND["by_scale"][0]) ** (1.0 / _MOTORS))
_CORNERS = np.array(list(product((0, 1), repeat=_MOTORS)))


class Start(NamedTuple):
    """A walker after its first action.

    Attributes:
        place: (2,) of the hull's origin: from the middle of the flat ground, and above it [m].
        angles: (5,) of the bodies [rad].
        moving: (7,) speeds u of `body.py`.
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


def after(action: jax.Array, gravity: jax.Array, friction: jax.Array, scale: jax.Array) -> Start:
    """The state after a first action, (4,) within -1..1."""
    at = (action + 1.0) / 2.0 * (_STRENGTHS - 1)
    below = jnp.clip(jnp.floor(at), 0, _STRENGTHS - 2)
    weights = jnp.where(_CORNERS == 1, at - below, 1.0 - (at - below)).prod(axis=1)  # (16,)
    rows = (below.astype(jnp.int32) + _CORNERS) @ _STRENGTHS ** np.arange(_MOTORS)[::-1]
    numbers = jnp.zeros(16)
    for axis, value in zip(AXES, (gravity, friction, scale), strict=True):
        (low, high), share = _between(axis, value)
        table = jnp.asarray(_FOUND[f"by_{axis}"])
        some = (1.0 - share) * table[low, rows] + share * table[high, rows]
        numbers = numbers + (weights[:, None] * some).sum(axis=0)
    return Start(numbers[:2], numbers[2:7], numbers[7:14], numbers[14:] > 0.5)


def _between(axis: str, value: jax.Array) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
    """Rows of the two nearest values, and how near the second is, 0..1."""
    values = jnp.asarray(_FOUND[axis])
    high = jnp.clip(jnp.searchsorted(values, value), 1, len(_FOUND[axis]) - 1)
    share = (value - values[high - 1]) / (values[high] - values[high - 1])
    return (high - 1, high), jnp.clip(share, 0.0, 1.0)
