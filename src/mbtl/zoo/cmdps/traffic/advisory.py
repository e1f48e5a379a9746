"""Advisory autonomy: what ring and ramp share (cmdp-spec, 7.1).

An advised driver keeps each instruction for the *hold*, the context: 1 s to 40 s. All cars follow
IDM with Gaussian acceleration noise. SUMO's own IDM has no noise, so we add it through the API:
after each step every human car's speed is moved by N(0, 0.2 m/s^2) x 0.1 s, and SUMO plans the next
step, with all its safety checks, from there. Against driving the cars with an IDM of our own this
keeps SUMO's lane changes, junctions and safety, and costs two calls per car and step.
"""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete, Space

from mbtl.errors import ContextMismatch, InvalidInput, check_known

STEP = 0.1
"""Seconds of one simulation step."""

WARM_UP, UNMEASURED, MEASURED = 1000, 2000, 2000
"""Simulation steps: without control, with control, and with control and measured."""

HORIZON = 400
"""Decisions of an episode at a hold of 1 s."""

NOISE = 0.2
"""Standard deviation of a human driver's acceleration [m/s^2], drawn every step."""

LENGTH, MIN_GAP = 5.0, 2.0
ACCEL, DECEL, TAU = 1.0, 1.5, 1.0
MAX_SPEED, ROAD_LIMIT = 30.0, 13.89
SPEED_SPREAD = 0.1
"""Standard deviation of the desired speed around the limit, a share."""
IMPATIENCE = 0.5
"""How readily a driver who merges makes others brake, 0..1."""

Actions = Literal["acceleration", "speed"]
Seen = Literal["fresh", "stale"]

IDM = (
    f'carFollowModel="IDM" accel="{ACCEL:g}" decel="{DECEL:g}" minGap="{MIN_GAP:g}" '
    f'tau="{TAU:g}" delta="4" length="{LENGTH:g}" maxSpeed="{MAX_SPEED:g}" '
    f'speedFactor="normc(1,{SPEED_SPREAD:g},0.2,2)" impatience="{IMPATIENCE:g}"'
)
"""Attributes of every car; the speed factor is SUMO's usual spread of the desired speed."""

SPEED_MODE = 0b11011
"""How SUMO treats the advised speed: all of its checks but that of comfortable braking, which would
overrule the one of the safe speed: a car told to hurry would then run into its leader. `Advice`
brakes comfortably itself, and SUMO harder where safety needs it."""

PATIENCE = 0.5
"""Seconds for which a car that finds no room to enter tries again; then it is dropped."""

OPTIONS = ["--max-depart-delay", f"{PATIENCE:g}", "--collision.action", "remove"]


def hold_steps(hold: float) -> int:
    """Simulation steps of one decision.

    Raises:
        ContextMismatch: the hold is no whole number of steps.
    """
    steps = round(hold / STEP)
    if steps < 1 or not math.isclose(steps * STEP, hold, rel_tol=1e-6):
        raise ContextMismatch(f"hold takes whole multiples of {STEP} s, got {hold!r}")
    return steps


def decisions(hold: float, horizon: int) -> int:
    """Decisions of one episode: 400 at a hold of 1 s, 10 at 40 s, never more than `horizon`."""
    return min(horizon, math.ceil((UNMEASURED + MEASURED) / hold_steps(hold)))


def check_seen(seen: Seen) -> None:
    """Refuse anything but "fresh" and "stale"."""
    check_known("observation", seen, ("fresh", "stale"))


def level_of(action: Any, levels: int) -> int:
    """A speed level as a number.

    Raises:
        InvalidInput: it is none of 0 .. levels - 1.
    """
    level = int(action)
    if level != action or not 0 <= level < levels:
        raise InvalidInput(f"speed levels are whole numbers from 0 to {levels - 1}, got {action!r}")
    return level


class Advice(NamedTuple):
    """One instruction; exactly one of the two acts.

    Attributes:
        target: speed to reach and keep [m/s]; None: accelerate.
        acceleration: [m/s^2].
    """

    target: float | None = None
    acceleration: float = 0.0

    def speed(self, now: float) -> float:
        """The speed of the next simulation step, given the present one [m/s]."""
        wish = now + self.acceleration * STEP if self.target is None else self.target
        return max(0.0, wish, now - DECEL * STEP)


def action_space(actions: Actions, levels: int) -> Space[Any]:
    """-1..1 of the strongest acceleration, or one of `levels` speeds."""
    return Box(-1.0, 1.0, (1,), np.float32) if actions == "acceleration" else Discrete(levels)


class Drivers:
    """The noise of human drivers."""

    def __init__(self, rng: np.random.Generator, noise: float = NOISE) -> None:
        """No step has been made yet.

        Args:
            rng: where the noise comes from.
            noise: standard deviation [m/s^2]; 0: stock IDM.
        """
        self._rng, self._scale = rng, noise * STEP

    def step(self, api: Any, cars: Sequence[str], steady: Container[str]) -> list[float]:
        """One simulation step's bookkeeping: read all speeds, then disturb those of humans.

        Args:
            api: the simulation, just stepped.
            cars: ids of all cars on the road.
            steady: cars without noise.

        Returns:
            (cars,) the speeds before the disturbance, which are those of this step.
        """
        read, write = api.vehicle.getSpeed, api.vehicle.setPreviousSpeed
        speeds = [read(car) for car in cars]
        if self._scale > 0.0:
            noise = self._rng.normal(0.0, self._scale, len(cars)).tolist()
            for car, speed, change in zip(cars, speeds, noise, strict=True):
                if car not in steady:
                    write(car, max(0.0, speed + change))
        return speeds
