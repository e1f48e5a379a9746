"""Ring road, twin of `mbtl.cmdps.traffic.ring` (cmdp-spec, 7.2): same cars, rules and numbers.

Notation (shapes): n simulations; arrays of cars are (cars, n), car i + 1 is the leader of car i and
car 0 is advised. gap_i: from the front of car i to the back of its leader [m].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mbtl.training.jax.environments import Box, Discrete, TimeLimit
from mbtl.training.jax.traffic import random
from mbtl.training.jax.traffic.idm import IDM, follow, obey
from mbtl.training.jax.traffic.twin import Moved, Seeded, Seen

_SHARES, _FACTORS, _NOISE = range(3)  # streams of random numbers


class RingParams(NamedTuple):
    """One context.

    Attributes:
        hold: simulation steps of one decision.
        visible: (v,) features appended to each observation.
    """

    hold: jax.Array
    visible: jax.Array


class RingState(NamedTuple):
    """n rings.

    Attributes:
        gap: (cars, n) [m].
        speed: (cars, n) what the next step starts from: with the driver's noise [m/s].
        driven: (cars, n) speed in the last step [m/s].
        desired: (cars, n) v0 [m/s].
        seed: (n,) uint32.
        steps: simulation steps since the warm-up began.
        running: (n,) no cars have collided.
        total: (n,) sum of the driven speeds over cars and measured steps.
        seen: (3, n) what the advised driver saw last, raw.
    """

    gap: jax.Array
    speed: jax.Array
    driven: jax.Array
    desired: jax.Array
    seed: jax.Array
    steps: jax.Array
    running: jax.Array
    total: jax.Array
    seen: jax.Array


Advice = Callable[[RingState], jax.Array]
"""state -> (cars, n) speeds of the next step."""


@dataclass(frozen=True)
class RingTwin(Seeded):
    """One advised car among many; constants are those of the SUMO environment.

    Attributes:
        action: an acceleration in -1..1, or a speed level.
        cars: on the ring.
        circumference: [m].
        car_length: [m].
        min_gap: of human drivers [m].
        advised_min_gap: of the advised car [m].
        driver: the car-following model of all.
        road_limit: [m/s].
        max_speed: of the cars [m/s].
        speed_factor: standard deviation of the desired speed around the limit, a share.
        noise: standard deviation of a human's acceleration [m/s^2].
        dt: seconds of a simulation step.
        warm_up: simulation steps without advice.
        unmeasured: advised steps before the score counts.
        total_steps: advised steps; the last hold may go beyond.
        reach: largest advised acceleration [m/s^2].
        top_speed: highest advised speed [m/s].
        collision: reward of a step in which cars collide.
        scale: divisors of speed, leader's speed and distance in an observation.
        time_limit: how the end of an episode is reported.
        stale: observe as after the first simulation step of the hold before.
        uniform: start with equal gaps.
    """

    action: Discrete | Box
    cars: int
    circumference: float
    car_length: float
    min_gap: float
    advised_min_gap: float
    driver: IDM
    road_limit: float
    max_speed: float
    speed_factor: float
    noise: float
    dt: float
    warm_up: int
    unmeasured: int
    total_steps: int
    reach: float
    top_speed: float
    collision: float
    scale: tuple[float, float, float]
    time_limit: TimeLimit = "truncation"
    stale: bool = False
    uniform: bool = False
    agents: int = 1
    n_features: int = 3
    mixes: bool = False
    params: type[RingParams] = RingParams

    def decisions(self, params: RingParams) -> int:
        """Enough holds to fill the controlled time."""
        return math.ceil(self.total_steps / int(params.hold))

    # ---- episodes ----------------------------------------------------------------------------

    def start(self, seeds: jax.Array, params: RingParams) -> RingState:
        """Cars at rest with random gaps, then the warm-up."""
        state = self._placed(seeds)
        advise = partial(self._human_speeds, min_gap=self.min_gap)
        state = jax.lax.fori_loop(
            0, self.warm_up, lambda _, state: self._advance(state, advise, human=True), state
        )
        warm: RingState = state._replace(seen=self._look(state))
        return warm

    def observe(self, state: RingState, params: RingParams) -> Seen:
        """Own speed, leader's speed, distance between the fronts; then the visible features."""
        share = state.seen / jnp.asarray(self.scale)[:, None]
        physical = 2.0 * jnp.clip(share, 0.0, 1.0) - 1.0
        n = physical.shape[1]
        visible = jnp.broadcast_to(params.visible, (n, *params.visible.shape))
        obs = jnp.concatenate([physical.T, visible], axis=1).astype(jnp.float32)
        return Seen(obs[:, None], state.running[:, None])

    def step(self, state: RingState, action: jax.Array, params: RingParams) -> Moved:
        """Follow one instruction for the hold."""
        action = action.reshape(len(state.seed))

        def advise(state: RingState) -> jax.Array:
            human = self._human_speeds(state, self._advised_min_gaps())
            if isinstance(self.action, Discrete):
                target = self.top_speed * action / (self.action.n - 1)
            else:
                target = jnp.maximum(0.0, state.speed[0] + self.reach * action * self.dt)
            told = obey(self.driver, target, state.speed[0], human[0], self.dt)
            return human.at[0].set(told)

        return self._hold(state, advise, params)

    def drive(self, state: RingState, params: RingParams) -> Moved:
        """The advised car drives by itself, without noise."""
        advise = partial(self._human_speeds, min_gap=self._advised_min_gaps())
        return self._hold(state, advise, params)

    def score(self, state: RingState) -> jax.Array:
        """Mean speed of all cars over the measured part [m/s]; 0 before it and after a collision.

        So many cars stand from the collision on: whoever crashes late does not keep the mean.
        """
        measured = state.steps - self.warm_up - self.unmeasured
        return state.total / (self.cars * jnp.maximum(measured, 1))

    # ---- inside ------------------------------------------------------------------------------

    def _placed(self, seeds: jax.Array) -> RingState:
        shape, moment = (self.cars, len(seeds)), jnp.uint32(0)
        spare = self.circumference - self.cars * (self.car_length + self.min_gap)
        if self.uniform:
            shares = jnp.full(shape, 1.0 / self.cars)
        else:  # exponentials divided by their sum are uniform on the simplex
            shares = -jnp.log(random.uniform(seeds, _SHARES, moment, self.cars))
            shares = shares / shares.sum(axis=0)
        spread = 1.0 + self.speed_factor * random.normal(seeds, _FACTORS, moment, self.cars)
        rest, n = jnp.zeros(shape), len(seeds)
        return RingState(
            gap=self.min_gap + spare * shares,
            speed=rest,
            driven=rest,
            desired=jnp.minimum(self.max_speed, self.road_limit * jnp.clip(spread, 0.2, 2.0)),
            seed=seeds,
            steps=jnp.int32(0),
            running=jnp.ones(n, bool),
            total=jnp.zeros(n),
            seen=jnp.zeros((3, n)),
        )

    def _advised_min_gaps(self) -> jax.Array:
        gaps = jnp.full((self.cars, 1), self.min_gap)
        return gaps.at[0].set(self.advised_min_gap)

    def _human_speeds(self, state: RingState, min_gap: jax.Array | float) -> jax.Array:
        leader = _ahead(state.speed)
        return follow(self.driver, state.speed, leader, state.gap, min_gap, state.desired, self.dt)

    def _hold(self, state: RingState, advise: Advice, params: RingParams) -> Moved:
        was_running = state.running

        def one(_: int, carry: tuple[RingState, jax.Array, jax.Array]) -> Any:
            state, reward, steps = carry
            new = self._advance(state, advise, human=False)
            gained = jnp.where(new.running, new.driven[0], self.collision)
            reward = reward + jnp.where(state.running, gained, 0.0)
            return new, reward, steps + state.running

        n = len(state.seed)
        first = one(0, (state, jnp.zeros(n), jnp.zeros(n, jnp.int32)))
        early = self._look(first[0])
        state, reward, steps = jax.lax.fori_loop(1, params.hold, one, first)
        state = state._replace(seen=early if self.stale else self._look(state))
        mean = reward / jnp.maximum(steps, 1)
        return Moved(state, mean[:, None], (was_running & ~state.running)[:, None])

    def _advance(self, state: RingState, advise: Advice, *, human: bool) -> RingState:
        """One simulation step; rings with a collision stand still."""
        driven = jnp.where(state.running, advise(state), state.driven)
        gap = state.gap + jnp.where(state.running, self.dt * (_ahead(driven) - driven), 0.0)
        speed = driven
        if self.noise > 0.0:
            z = random.normal(state.seed, _NOISE, state.steps, self.cars)
            if not human:
                z = z.at[0].set(0.0)
            speed = jnp.maximum(0.0, driven + self.noise * self.dt * z)
        # SUMO counts human cars that come closer than half their smallest gap as collided
        least = 0.5 * self.min_gap if human else 0.5 * self._advised_min_gaps()
        running = state.running & (gap >= least).all(axis=0)
        advised = state.steps + 1 - self.warm_up
        counts = running & (advised > self.unmeasured)
        return state._replace(
            gap=gap,
            speed=speed,
            driven=driven,
            steps=state.steps + 1,
            running=running,
            total=state.total + jnp.where(counts, driven.sum(axis=0), 0.0),
        )

    def _look(self, state: RingState) -> jax.Array:
        """(3, n) what the advised driver sees; after a collision, what was seen before."""
        now = jnp.stack([state.speed[0], state.speed[1], state.gap[0] + self.car_length])
        return jnp.where(state.running, now, state.seen)


def _ahead(x: jax.Array) -> jax.Array:
    """The same of each car's leader."""
    return jnp.concatenate([x[1:], x[:1]])
