"""Ring road, twin of `mbtl.zoo.cmdps.traffic.ring` (cmdp-spec, 7.2): same cars, rules and numbers.

Notation (shapes): n simulations; arrays of cars are (cars, n), car i + 1 is the leader of car i and
car 0 is advised. gap_i: from the front of car i to the back of its leader [m].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mbtl.engine.worlds import random
from mbtl.engine.worlds.beats import HoldParams, Holds
from mbtl.engine.worlds.environments import Beats, Box, Discrete, TimeLimit
from mbtl.engine.worlds.world import Moved, Seen
from mbtl.zoo.worlds.traffic.idm import IDM, follow, obey

_SHARES, _FACTORS, _NOISE = range(3)  # streams of random numbers


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
        measured: (n,) steps that count.
        total: (n,) sum of the driven speeds over cars and these steps.
        seen: (3, n) what the advised driver saw last, raw.
    """

    gap: jax.Array
    speed: jax.Array
    driven: jax.Array
    desired: jax.Array
    seed: jax.Array
    steps: jax.Array
    running: jax.Array
    measured: jax.Array
    total: jax.Array
    seen: jax.Array


class Held(NamedTuple):
    """What happened since the last decision, (n,) unless said otherwise.

    Attributes:
        told: the instruction, an acceleration or a level.
        reward: sum over the steps in which cars had not collided before.
        steps: so many.
        began: there had been no collision then.
        early: (3, n) what the advised driver saw after the first step.
    """

    told: jax.Array
    reward: jax.Array
    steps: jax.Array
    began: jax.Array
    early: jax.Array


Speeds = Callable[[RingState], jax.Array]
"""state -> (cars, n) speeds of the next step."""

Advice = Callable[[RingState, Held], jax.Array]
"""The same under an instruction."""


@dataclass(frozen=True)
class RingTwin(Holds):
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
    params: type[HoldParams] = HoldParams

    # ---- episodes ----------------------------------------------------------------------------

    def start(self, seeds: jax.Array, params: HoldParams) -> RingState:
        """Cars at rest with random gaps, then the warm-up."""
        state = self._placed(seeds)
        advise = partial(self._human_speeds, min_gap=self.min_gap)
        state = jax.lax.fori_loop(
            0, self.warm_up, lambda _, state: self._advance(state, advise, human=True), state
        )
        warm: RingState = state._replace(seen=self._look(state))
        return warm

    def observe(self, state: RingState, params: HoldParams) -> Seen:
        """Own speed, leader's speed, distance between the fronts; then the visible features."""
        share = state.seen / jnp.asarray(self.scale)[:, None]
        physical = 2.0 * jnp.clip(share, 0.0, 1.0) - 1.0
        n = physical.shape[1]
        visible = jnp.broadcast_to(params.visible, (n, params.visible.shape[-1]))
        obs = jnp.concatenate([physical.T, visible], axis=1).astype(jnp.float32)
        return Seen(obs[:, None], state.running[:, None])

    def step(self, state: RingState, action: jax.Array, params: HoldParams) -> Moved:
        """Follow one instruction for the hold."""
        held = self.held(state)._replace(told=action.reshape(-1))
        return self._hold(state, held, self._told, params)

    def drive(self, state: RingState, params: HoldParams) -> Moved:
        """The advised car drives by itself, without noise."""
        return self._hold(state, self.held(state), self._undisturbed, params)

    # ---- decisions that last differently long ------------------------------------------------

    def held(self, state: RingState) -> Held:
        """See `mbtl.engine.worlds.beats.Holds`."""
        rest, none = jnp.zeros_like(state.total), jnp.zeros_like(state.measured)
        return Held(rest, rest, none, state.running, state.seen)

    def beat(
        self,
        state: RingState,
        held: Held,
        action: jax.Array,
        params: HoldParams,
        beats: Beats,
        now: jax.Array,
    ) -> tuple[Moved, Held]:
        """See `mbtl.engine.worlds.beats.Holds`."""
        every, decisions = self.beats(params, beats)
        due, over = now % every == 0, now >= every * decisions
        anew = self.held(state)._replace(told=action.reshape(-1).astype(jnp.float32))
        held = jax.tree.map(partial(jnp.where, due), anew, held)
        state, held = self._through(state, held, self._told, beats.steps, due, over)
        ends = ((now + 1) % every == 0) & ~over
        seen = held.early if self.stale else self._look(state)
        state = state._replace(seen=jnp.where(ends, seen, state.seen))
        reward = jnp.where(ends, _mean_reward(held), 0.0)
        done = ends & held.began & ~state.running
        return Moved(state, reward[:, None], done[:, None]), held

    def score(self, state: RingState) -> jax.Array:
        """Mean speed of all cars over the measured part [m/s]; 0 before it and after a collision.

        So many cars stand from the collision on: whoever crashes late does not keep the mean.
        """
        return state.total / (self.cars * jnp.maximum(state.measured, 1))

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
            measured=jnp.zeros(n, jnp.int32),
            total=jnp.zeros(n),
            seen=jnp.zeros((3, n)),
        )

    def _advised_min_gaps(self) -> jax.Array:
        gaps = jnp.full((self.cars, 1), self.min_gap)
        return gaps.at[0].set(self.advised_min_gap)

    def _human_speeds(self, state: RingState, min_gap: jax.Array | float) -> jax.Array:
        leader = _ahead(state.speed)
        return follow(self.driver, state.speed, leader, state.gap, min_gap, state.desired, self.dt)

    def _told(self, state: RingState, held: Held) -> jax.Array:
        human = self._undisturbed(state, held)
        if isinstance(self.action, Discrete):
            target = self.top_speed * held.told / (self.action.n - 1)
        else:
            target = jnp.maximum(0.0, state.speed[0] + self.reach * held.told * self.dt)
        told = obey(self.driver, target, state.speed[0], human[0], self.dt)
        return human.at[0].set(told)

    def _undisturbed(self, state: RingState, held: Held) -> jax.Array:
        return self._human_speeds(state, self._advised_min_gaps())

    def _hold(self, state: RingState, held: Held, advise: Advice, params: HoldParams) -> Moved:
        """One decision of all rings, as long in each."""
        all_, nobody = jnp.array(True), jnp.array(False)
        state, held = self._through(state, held, advise, params.hold, all_, nobody)
        state = state._replace(seen=held.early if self.stale else self._look(state))
        done = held.began & ~state.running
        return Moved(state, _mean_reward(held)[:, None], done[:, None])

    def _through(
        self,
        state: RingState,
        held: Held,
        advise: Advice,
        steps: jax.Array | int,
        due: jax.Array,
        over: jax.Array,
    ) -> tuple[RingState, Held]:
        """So many steps; a decision was `due` before them, and where it is `over` none is taken."""

        def one(_: int, carry: tuple[RingState, Held]) -> tuple[RingState, Held]:
            state, held = carry
            new = self._advance(state, lambda state: advise(state, held), human=False, over=over)
            gained = jnp.where(new.running, new.driven[0], self.collision)
            reward = held.reward + jnp.where(state.running, gained, 0.0)
            return new, held._replace(reward=reward, steps=held.steps + state.running)

        state, held = one(0, (state, held))
        held = held._replace(early=jnp.where(due, self._look(state), held.early))
        after: tuple[RingState, Held] = jax.lax.fori_loop(1, steps, one, (state, held))
        return after

    def _advance(
        self, state: RingState, advise: Speeds, *, human: bool, over: jax.Array | bool = False
    ) -> RingState:
        """One simulation step; rings with a collision, or whose episode is over, stand still."""
        moves = state.running & jnp.logical_not(over)
        driven = jnp.where(moves, advise(state), state.driven)
        gap = state.gap + jnp.where(moves, self.dt * (_ahead(driven) - driven), 0.0)
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
        counts = (advised > self.unmeasured) & jnp.logical_not(over)
        return state._replace(
            gap=gap,
            speed=speed,
            driven=driven,
            steps=state.steps + 1,
            running=running,
            measured=state.measured + counts,
            total=state.total + jnp.where(running & counts, driven.sum(axis=0), 0.0),
        )

    def _look(self, state: RingState) -> jax.Array:
        """(3, n) what the advised driver sees; after a collision, what was seen before."""
        now = jnp.stack([state.speed[0], state.speed[1], state.gap[0] + self.car_length])
        return jnp.where(state.running, now, state.seen)


def _mean_reward(held: Held) -> jax.Array:
    return held.reward / jnp.maximum(held.steps, 1)


def _ahead(x: jax.Array) -> jax.Array:
    """The same of each car's leader."""
    return jnp.concatenate([x[1:], x[:1]])
