"""How walkers of Box2D stand two steps after they were put together.

Their legs are put half a metre too high and pushed out of the ground at once, which joints that
hold exactly cannot do; and a first action is mixed into it, which moves the knees by half a turn.
So an episode in jax begins two steps later, in one of many states that Box2D's walkers had then,
each after a first action of its own. A policy that learns from one of them alone walks nowhere
else, not in Box2D either.

Notation (shapes): s scales, b first actions.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

FILE = Path(__file__).parent / "starts.npz"
"""`evidence/walker_twin.py --part start --write` wrote it: `scales` (s,), `states` (s, b, 16)."""
with np.load(FILE) as _file:
    _SCALES, _STATES = _file["scales"], _file["states"]


class Start(NamedTuple):
    """One state, at a scale.

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


def start(luck: jax.Array, scale: jax.Array) -> Start:
    """The state of a uniform number, between those of the two nearest scales."""
    scales, states = jnp.asarray(_SCALES), jnp.asarray(_STATES)
    which = jnp.floor(luck * states.shape[1]).astype(jnp.int32)
    above = jnp.clip(jnp.searchsorted(scales, scale), 1, len(_SCALES) - 1)
    share = jnp.clip((scale - scales[above - 1]) / (scales[above] - scales[above - 1]), 0.0, 1.0)
    low, high = states[above - 1, which], states[above, which]
    numbers = low + share * (high - low)
    return Start(numbers[:2], numbers[2:7], numbers[7:14], numbers[14:] > 0.5)
