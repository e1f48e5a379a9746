"""CartPole as pure functions; physics and notation of `zoo.cmdps.cartpole` (cmdp-spec, 4.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mbtl.engine.worlds.environments import Discrete, Step, TimeLimit, stack_observation

X_LIMIT = 2.4
ANGLE_LIMIT = math.radians(12.0)
RESET_HALF_WIDTH = 0.05
LEFT_OR_RIGHT = Discrete(2)


class CartPoleParams(NamedTuple):
    """Constants of the Euler step, as `mbtl.zoo.cmdps.cartpole.derive` orders them; scalars."""

    gravity: jax.Array
    force: jax.Array
    timestep: jax.Array
    length: jax.Array
    pole_mass: jax.Array
    total_mass: jax.Array
    pole_moment: jax.Array
    visible: jax.Array


class CartPoleState(NamedTuple):
    """x [m], v [m/s], t [rad from upright], w [rad/s]."""

    x: jax.Array
    v: jax.Array
    t: jax.Array
    w: jax.Array


@dataclass(frozen=True)
class CartPole:
    """Balance a pole on a cart pushed left (0) or right (1)."""

    horizon: int = 500
    time_limit: TimeLimit = "truncation"
    action: Discrete = LEFT_OR_RIGHT
    n_features: int = 4
    n_noise: int = 4
    params: type[CartPoleParams] = CartPoleParams

    @property
    def max_return(self) -> float:
        """1 per step, up to the horizon."""
        return float(self.horizon)

    def initial(self, noise: jax.Array, params: CartPoleParams) -> CartPoleState:
        """Every state variable uniform in +-0.05."""
        spread = RESET_HALF_WIDTH * (2.0 * noise - 1.0)
        return CartPoleState(*(spread.astype(params.length.dtype)))

    def step(self, state: CartPoleState, action: jax.Array, params: CartPoleParams) -> Step:
        """One explicit Euler step; reward 1."""
        x, v, t, w = state
        g, force, tau, length, m, total, p, _ = params
        push = jnp.where(action == 1, force, -force)
        sin, cos = jnp.sin(t), jnp.cos(t)
        a = (push + p * w * w * sin) / total
        w_dot = (g * sin - a * cos) / (length * (4.0 / 3.0 - m * cos * cos / total))
        v_dot = a - p * w_dot * cos / total
        new = CartPoleState(x + tau * v, v + tau * v_dot, t + tau * w, w + tau * w_dot)
        # written so that NaN ends the episode, as in the Gymnasium environment
        inside = (jnp.abs(new.x) <= X_LIMIT) & (jnp.abs(new.t) <= ANGLE_LIMIT)
        return Step(new, jnp.ones_like(x), ~inside)

    def observe(self, state: CartPoleState, params: CartPoleParams) -> jax.Array:
        """x, v, t, w and the visible features."""
        return stack_observation(state, params.visible)
