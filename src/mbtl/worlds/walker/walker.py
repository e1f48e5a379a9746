"""BipedalWalker as pure functions; environment and notation of `mbtl.cmdps.locomotion.walker`.

Box2D's world of five bodies, with two things done otherwise. Joints hold exactly, so seven numbers
move all (`body.py`). And what the first action does is looked up (`starts.py`). How near the two
are, page docs/locomotion.md says.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.worlds import environments, random
from mbtl.worlds.environments import TimeLimit
from mbtl.worlds.vectorised import batch_last
from mbtl.worlds.walker import ground, starts
from mbtl.worlds.walker.body import HULL, Body, across, body, offset, turned
from mbtl.worlds.walker.contact import PIECES, SKIN
from mbtl.worlds.walker.motion import (
    FPS,
    JOINTS,
    MADE,
    WalkerParams,
    WalkerState,
    body_of,
    joint_angles,
    moved,
)

TORQUE = 80.0
SPEEDS = np.array([4.0, 6.0, 4.0, 6.0], np.float32)
"""Of hips and knees [rad/s], at full speed."""
STANCE = (-0.2, 0.0, 0.2, 0.0)
"""An action with which it stands still: hips held apart. Without any torque it falls."""

_ACTION = environments.Box((-1.0,) * 4, (1.0,) * 4)
_PUSH = 5.0
"""Largest force on the hull in the first step [N]."""
_ANEW = np.int32(-1)
"""Instead of numbers of pieces of ground, this or less: no action has been taken. How much less is
the luck of the four motors."""
_LUCKS = np.float32(2.0**20)
_MIDDLE = np.array([ground.STEP * ground.FLAT / 2.0, ground.HEIGHT], np.float32)
"""Of the flat ground at the beginning [m]."""
_HULL_PIECES = 11
"""Of ground below the hull; a larger hull lies on the ground from the start."""


@dataclass(frozen=True)
class BipedalWalker:
    """Walk to the far end of slightly uneven ground, with motors in two hips and two knees."""

    horizon: int = 1000
    time_limit: TimeLimit = "truncation"
    action: environments.Box = _ACTION
    n_features: int = 24
    n_noise: int = 2
    max_return: float | None = None
    idle: tuple[float, ...] = STANCE
    params: type[WalkerParams] = WalkerParams

    def initial(self, noise: jax.Array, params: WalkerParams) -> WalkerState:
        """A walker on new ground, with a push."""
        words = jnp.floor(noise * 2.0**24).astype(jnp.uint32)
        seed = (words[0] ^ (words[1] << 8))[None]
        count = ground.ROUGH + ground.PATCHES + 1
        luck = random.uniform(seed, 0, jnp.uint32(0), count + 4)[:, 0]
        place, angles = starts.made(params.scale)
        push = (-_PUSH + 2.0 * _PUSH * luck[count - 1]) / FPS
        pushed = push / body(jnp.zeros(2), angles, params.scale).masses[0]
        moving = jnp.zeros((5, 3)).at[0, :2].set(jnp.stack([pushed, -params.gravity / FPS]))
        return WalkerState(
            _MIDDLE + place + turned(angles[0], *offset(params.scale)),
            angles,
            moving,
            ground.heights(luck[: count - 1], params.scale),
            _ANEW - (luck[count:] * _LUCKS).astype(jnp.int32),
            jnp.zeros((4, PIECES), bool),
            jnp.ones(2, bool),
        )

    def step(
        self, state: WalkerState, action: jax.Array, params: WalkerParams
    ) -> environments.Step:
        """One step of 1/50 s; actions beyond +-1 act as +-1."""
        strength = jnp.minimum(jnp.abs(action), 1.0)
        new = moved(state, jnp.sign(action) * SPEEDS, TORQUE * strength, params)
        small, later = state._replace(heights=()), new._replace(heights=())
        first = _or_begun(small, later, jnp.clip(action, -1.0, 1.0), params._replace(visible=()))
        new = first._replace(heights=new.heights)
        now, x = body_of(new, params), _origin(new, params)[0]
        fallen = _lies(now, new, params) | (x < 0.0)
        gain = _progress(new, params) - _progress(state, params)
        reward = jnp.where(fallen, -100.0, gain - 0.00035 * TORQUE * strength.sum())
        return environments.Step(new, reward, fallen | (x > ground.END) | ~jnp.isfinite(x))

    def observe(self, state: WalkerState, params: WalkerParams) -> jax.Array:
        """Hull, joints, feet, ranges and the visible features, as Gymnasium orders them."""
        hull, turning = state.moving[0], state.moving[:, 2] @ JOINTS[:, 2:].T / SPEEDS
        view = 0.3 / FPS / params.scale
        bent = joint_angles(state.angles) - MADE + jnp.array([0.0, 1.0, 0.0, 1.0])
        joints = jnp.stack([bent, turning], axis=-1).reshape(2, 4)
        legs = jnp.concatenate([joints, state.feet[:, None]], axis=1).reshape(-1)
        seen = [
            jnp.stack([
                state.angles[0],
                2.0 * hull[2] / FPS,
                600.0 * view * hull[0],
                400.0 * view * hull[1],
            ]),
            legs,
            ground.ranges(state.heights, _origin(state, params)),
            params.visible,
        ]  # fmt: skip
        return jnp.concatenate(seen).astype(jnp.float32)


def _begun(
    state: WalkerState, later: WalkerState, action: jax.Array, params: WalkerParams
) -> WalkerState:
    """The state after a first action, whose walker was pushed before.

    What it touched is as in `later`: where it stood when the step began.
    """
    luck = (_ANEW - state.first) / _LUCKS
    start = starts.after(action, luck, params.gravity, params.friction, params.scale)
    return later._replace(
        centre=_MIDDLE + start.place + turned(start.angles[0], *offset(params.scale)),
        angles=start.angles,
        moving=start.moving.at[0, 0].add(state.moving[0, 0]),
        feet=start.feet,
    )


@batch_last
def _or_begun(
    state: WalkerState, later: WalkerState, action: jax.Array, params: WalkerParams
) -> WalkerState:
    """What `later` says, or the state after a first action; looked up where anybody begins."""
    anew = (state.first[0] <= _ANEW) & jnp.isfinite(action).all(axis=0)  # (n,)

    def looked_up() -> WalkerState:
        begun = jax.vmap(_begun, -1, -1)(state, later, action, params)
        chosen: WalkerState = jax.tree.map(lambda a, b: jnp.where(anew, a, b), begun, later)
        return chosen

    found: WalkerState = jax.lax.cond(anew.any(), looked_up, lambda: later)
    return found


def _origin(state: WalkerState, params: WalkerParams) -> jax.Array:
    """(2,) of the hull [m]."""
    return state.centre - turned(state.angles[0], *offset(params.scale))


def _progress(state: WalkerState, params: WalkerParams) -> jax.Array:
    """What the way so far is worth."""
    x = _origin(state, params)[0]
    return 130.0 * x / params.scale - 5.0 * jnp.abs(state.angles[0])


def _lies(now: Body, state: WalkerState, params: WalkerParams) -> jax.Array:
    """Whether the hull touches the ground."""
    corners = jnp.asarray(HULL, jnp.float32) / params.scale
    at = now.origin + turned(state.angles[0], *corners.T).T  # (5, 2), clockwise
    piece = jnp.clip(jnp.floor(at[:, 0] / ground.STEP), 0, ground.POINTS - 2).astype(jnp.int32)
    left, right = state.heights[piece], state.heights[piece + 1]
    level = left + (right - left) * (at[:, 0] / ground.STEP - piece)
    above = (at[:, 0] >= 0.0) & (at[:, 0] <= ground.STEP * (ground.POINTS - 1))
    corner = above & (at[:, 1] - level < SKIN)
    first = ground.number(now.origin[0] - ground.STEP * _HULL_PIECES / 2.0, _HULL_PIECES)
    points = ground.pieces(state.heights, first, _HULL_PIECES)
    outward = across((jnp.roll(at, -1, axis=0) - at).T).T
    outward = outward / jnp.sqrt((outward * outward).sum(-1, keepdims=True))
    out = ((points[:, None] - at[None]) * outward[None]).sum(-1).max(-1)
    return corner.any() | (out < SKIN).any()
