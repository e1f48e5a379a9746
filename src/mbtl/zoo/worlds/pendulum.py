"""Pendulum as pure functions; physics and notation of `zoo.cmdps.pendulum` (cmdp-spec, 4.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mbtl.engine.worlds.environments import Box, Step, TimeLimit, stack_observation

MAX_TORQUE = 2.0
TORQUE = Box((-MAX_TORQUE,), (MAX_TORQUE,))


class PendulumParams(NamedTuple):
    """Constants of one step, as `mbtl.zoo.cmdps.pendulum.derive` orders them; scalars."""

    gravity_gain: jax.Array
    torque_gain: jax.Array
    timestep: jax.Array
    max_speed: jax.Array
    visible: jax.Array


class PendulumState(NamedTuple):
    """t [rad from upright, not wrapped], w [rad/s]."""

    t: jax.Array
    w: jax.Array


def wrapped(angle: jax.Array) -> jax.Array:
    """The same angle in (-pi, pi)."""
    return angle - 2.0 * math.pi * jnp.floor((angle + math.pi) / (2.0 * math.pi))


@dataclass(frozen=True)
class Pendulum:
    """Swing a pendulum up and hold it, with a torque of at most 2 N m; it never terminates."""

    horizon: int = 200
    time_limit: TimeLimit = "truncation"
    action: Box = TORQUE
    n_features: int = 3
    n_noise: int = 2
    max_return: float = 0.0
    idle: tuple[float, ...] = (0.0,)
    params: type[PendulumParams] = PendulumParams

    def initial(self, noise: jax.Array, params: PendulumParams) -> PendulumState:
        """T uniform in +-pi, w uniform in +-1."""
        spread = (2.0 * noise - 1.0).astype(params.timestep.dtype)
        return PendulumState(math.pi * spread[0], spread[1])

    def step(self, state: PendulumState, action: jax.Array, params: PendulumParams) -> Step:
        """One step; torques beyond the limit are clipped."""
        t, w = state
        gravity_gain, torque_gain, dt, max_speed, _ = params
        u = jnp.clip(action[0], -MAX_TORQUE, MAX_TORQUE)
        off = wrapped(t)
        reward = -(off * off + 0.1 * w * w + 0.001 * u * u)
        w = jnp.clip(w + gravity_gain * jnp.sin(t) + torque_gain * u, -max_speed, max_speed)
        return Step(PendulumState(t + w * dt, w), reward, jnp.zeros_like(t, dtype=bool))

    def observe(self, state: PendulumState, params: PendulumParams) -> jax.Array:
        """Cos t, sin t, w and the visible features."""
        return stack_observation((jnp.cos(state.t), jnp.sin(state.t), state.w), params.visible)
