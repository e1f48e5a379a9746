"""Worlds of the small problems: Acrobot, MountainCar, and any world seen through bad sensors.

Acrobot is Gymnasium's `Acrobot-v1` ("book"), MountainCar its `MountainCarContinuous-v0` with a
reward for energy, since PPO finds the goal only by luck without one. Both are pure functions
(`mbtl.engine.worlds.Environment`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp

from mbtl.engine.worlds.environments import (
    Box,
    Discrete,
    Environment,
    Step,
    TimeLimit,
    Tree,
    stack_observation,
)
from mbtl.engine.worlds.random import mix
from mbtl.zoo.worlds import CartPole, Pendulum
from mbtl.zoo.worlds.pendulum import wrapped


@dataclass(frozen=True)
class Cart(CartPole):
    """CartPole, for shorter, and learnt like any other world."""

    horizon: int = 200


@dataclass(frozen=True)
class Swing(Pendulum):
    """Pendulum, likewise."""

    horizon: int = 100


class AcrobotParams(NamedTuple):
    """Scalars; both links have one length [m], their centres of mass in the middle."""

    gravity: jax.Array
    length: jax.Array
    mass: jax.Array
    moment: jax.Array
    torque: jax.Array
    timestep: jax.Array
    visible: jax.Array


class AcrobotState(NamedTuple):
    """Angles [rad] of the first link from below and of the second from the first; speeds."""

    a: jax.Array
    b: jax.Array
    v: jax.Array
    w: jax.Array


@dataclass(frozen=True)
class Acrobot:
    """Swing the tip of two links above the bar, by a torque between them: -1, 0 or 1."""

    horizon: int = 200
    time_limit: TimeLimit = "truncation"
    action: Discrete = Discrete(3)  # noqa: RUF009
    n_features: int = 6
    n_noise: int = 4
    max_return: float | None = None
    params: type[AcrobotParams] = AcrobotParams

    def initial(self, noise: jax.Array, params: AcrobotParams) -> AcrobotState:
        """Every state variable uniform in +-0.1."""
        return AcrobotState(*(0.2 * noise - 0.1).astype(params.gravity.dtype))

    def step(self, state: AcrobotState, action: jax.Array, params: AcrobotParams) -> Step:
        """One step of fourth-order Runge-Kutta; -1 until the tip is up."""
        torque, h = params.torque * (action - 1), params.timestep

        def slope(at: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
            return _acrobot(at, torque, params)

        def ahead(by: jax.Array | float, along: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
            return tuple(x + by * d for x, d in zip(state, along, strict=True))

        k1 = slope(tuple(state))
        k2 = slope(ahead(h / 2, k1))
        k3 = slope(ahead(h / 2, k2))
        k4 = slope(ahead(h, k3))
        along = tuple(
            (p + 2 * q + 2 * r + s) / 6 for p, q, r, s in zip(k1, k2, k3, k4, strict=True)
        )
        a, b, v, w = ahead(h, along)
        v = jnp.clip(v, -4 * math.pi, 4 * math.pi)
        w = jnp.clip(w, -9 * math.pi, 9 * math.pi)
        new = AcrobotState(wrapped(a), wrapped(b), v, w)
        up = -jnp.cos(new.a) - jnp.cos(new.a + new.b) > 1.0
        return Step(new, jnp.where(up, 0.0, -1.0).astype(v.dtype), up)

    def observe(self, state: AcrobotState, params: AcrobotParams) -> jax.Array:
        """Cosine and sine of both angles, both speeds and the visible features."""
        a, b, v, w = state
        seen = (jnp.cos(a), jnp.sin(a), jnp.cos(b), jnp.sin(b), v, w)
        return stack_observation(seen, params.visible)


def _acrobot(
    state: tuple[jax.Array, ...], torque: jax.Array, p: AcrobotParams
) -> tuple[jax.Array, ...]:
    """Speeds and accelerations (Sutton and Barto)."""
    a, b, v, w = state
    middle = p.length / 2
    cos, sin = jnp.cos(b), jnp.sin(b)
    d1 = p.mass * (middle**2 + p.length**2 + middle**2 + 2 * p.length * middle * cos)
    d1 = d1 + 2 * p.moment
    d2 = p.mass * (middle**2 + p.length * middle * cos) + p.moment
    pull = p.mass * p.length * middle * sin
    phi2 = p.mass * middle * p.gravity * jnp.sin(a + b)
    phi1 = -pull * w**2 - 2 * pull * w * v + p.mass * (middle + p.length) * p.gravity * jnp.sin(a)
    phi1 = phi1 + phi2
    turn = torque + d2 / d1 * phi1 - pull * v**2 - phi2
    dw = turn / (p.mass * middle**2 + p.moment - d2**2 / d1)
    return v, w, -(d2 * dw + phi1) / d1, dw


CLIMB = 1e4
"""Reward per energy, MountainCar."""


class MountainCarParams(NamedTuple):
    """Scalars: push per action, pull of the hills, largest speed, and where the goal is."""

    power: jax.Array
    gravity: jax.Array
    max_speed: jax.Array
    goal: jax.Array
    visible: jax.Array


class MountainCarState(NamedTuple):
    """Position and speed."""

    x: jax.Array
    v: jax.Array


@dataclass(frozen=True)
class MountainCar:
    """Drive a weak car out of a valley.

    Reward: 100 at the goal, -0.1 action^2, and `CLIMB` per energy that was gained,
    v^2 / 2 + gravity sin(3x) / 3; the nominal hill is worth 16.
    """

    horizon: int = 200
    time_limit: TimeLimit = "truncation"
    action: Box = Box((-1.0,), (1.0,))  # noqa: RUF009
    n_features: int = 2
    n_noise: int = 1
    max_return: float | None = None
    params: type[MountainCarParams] = MountainCarParams

    def initial(self, noise: jax.Array, params: MountainCarParams) -> MountainCarState:
        """X uniform in (-0.6, -0.4), at rest."""
        x = (-0.6 + 0.2 * noise[0]).astype(params.power.dtype)
        return MountainCarState(x, jnp.zeros_like(x))

    def step(self, state: MountainCarState, action: jax.Array, params: MountainCarParams) -> Step:
        """One step; the left end stops the car."""
        x, v = state
        push = jnp.clip(action[0], -1.0, 1.0)
        new_v = v + params.power * push - params.gravity * jnp.cos(3 * x)
        new_v = jnp.clip(new_v, -params.max_speed, params.max_speed)
        new_x = jnp.clip(x + new_v, -1.2, 0.6)
        new_v = jnp.where((new_x <= -1.2) & (new_v < 0), 0.0, new_v)
        there = (new_x >= params.goal) & (new_v >= 0)
        gained = _energy(new_x, new_v, params) - _energy(x, v, params)
        reward = 100.0 * there - 0.1 * push**2 + CLIMB * gained
        return Step(MountainCarState(new_x, new_v), reward, there)

    def observe(self, state: MountainCarState, params: MountainCarParams) -> jax.Array:
        """Position, speed in hundredths, and the visible features."""
        return stack_observation((state.x, 100.0 * state.v), params.visible)


def _energy(x: jax.Array, v: jax.Array, p: MountainCarParams) -> jax.Array:
    return v**2 / 2 + p.gravity * jnp.sin(3 * x) / 3


class DisturbedState(NamedTuple):
    """Of the world inside; the seed of its sensors, steps so far, and actions under way."""

    inside: Tree
    seed: jax.Array
    elapsed: jax.Array
    late: jax.Array


@dataclass(frozen=True)
class Disturbed:
    """A world of one agent whose sensors are noisy and whose actions come late.

    Parameters are those of the world inside, `noise` (deviation of each number that is seen, in
    `scale`) and `delay` (steps, rounded); until the first action comes there is action 0.

    Attributes:
        inside: the world.
        scale: usual sizes of what is seen.
        most: longest delay, steps.
    """

    inside: Environment
    scale: tuple[float, ...]
    most: int = 5

    @property
    def horizon(self) -> int:
        """As inside."""
        return self.inside.horizon

    @property
    def time_limit(self) -> TimeLimit:
        """As inside."""
        return self.inside.time_limit

    @property
    def action(self) -> Discrete | Box:
        """As inside."""
        return self.inside.action

    @property
    def n_features(self) -> int:
        """As inside."""
        return self.inside.n_features

    @property
    def max_return(self) -> float | None:
        """As inside."""
        return self.inside.max_return

    @property
    def n_noise(self) -> int:
        """One number more, of the sensors."""
        return self.inside.n_noise + 1

    @property
    def params(self) -> type[Any]:
        """Those inside, noise and delay."""
        return _disturbed_params(cast(Any, self.inside.params))

    def _own(self, params: Tree) -> Tree:
        return self.inside.params(*params[:-3], params.visible)

    def initial(self, noise: jax.Array, params: Tree) -> DisturbedState:
        """As inside; nothing is under way."""
        inside = self.inside.initial(noise[:-1], self._own(params))
        one = () if isinstance(self.action, Discrete) else (len(self.action.low),)
        kind = jnp.int32 if isinstance(self.action, Discrete) else jnp.float32
        late = jnp.zeros((self.most, *one), kind)
        seed = (noise[-1] * 2.0**31).astype(jnp.uint32)
        return DisturbedState(inside, seed, jnp.uint32(0), late)

    def step(self, state: DisturbedState, action: jax.Array, params: Tree) -> Step:
        """One step, by the action that is due."""
        under_way = jnp.concatenate([action[None].astype(state.late.dtype), state.late])
        due = under_way[jnp.round(params.delay).astype(jnp.int32)]
        moved = self.inside.step(state.inside, due, self._own(params))
        new = DisturbedState(moved.state, state.seed, state.elapsed + 1, under_way[: self.most])
        return Step(new, moved.reward, moved.terminated)

    def observe(self, state: DisturbedState, params: Tree) -> jax.Array:
        """What is seen inside and the noise of this step; the visible features have none."""
        seen = self.inside.observe(state.inside, self._own(params))
        noise = params.noise * jnp.array(self.scale) * _uniform(state, self.n_features)
        return seen.at[: self.n_features].add(noise.astype(seen.dtype))


def _uniform(state: DisturbedState, count: int) -> jax.Array:
    """(count,) uniform numbers of deviation 1, of this step: cheaper than jax's own generator."""
    bits = state.seed + state.elapsed * jnp.uint32(2654435761)
    bits = bits + jnp.arange(count, dtype=jnp.uint32) * jnp.uint32(2246822519)
    return math.sqrt(12.0) * (mix(bits).astype(jnp.float32) / 2.0**32 - 0.5)


@cache
def _disturbed_params(inside: Any) -> type[Any]:
    """Class of the parameters, one per world."""
    names = (*inside._fields[:-1], "noise", "delay", "visible")
    made: Any = NamedTuple("DisturbedParams", [(name, jax.Array) for name in names])  # type: ignore[misc]
    return cast(type[Any], made)
