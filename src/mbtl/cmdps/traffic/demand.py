"""Cars of the traffic-signal family: when they come and where they go (cmdp-spec, 5).

n departure times are Weibull(2) draws, stretched linearly so that the whole numbers around the
second smallest and the largest become 0 and the end of the episode, and rounded to seconds. The
largest lies below 3, or with 12 % of the draws of 1000 cars (27 % of 2500) below 4: then the same
cars come within three quarters of the time, and the peak is a third higher.
"""

from __future__ import annotations

import numpy as np

from mbtl.arrays import Array

STRAIGHT_SHARE = 0.75
SHAPE = 2.0
LENGTH, DECELERATION = 5.0, 4.5
MIN_GAP, ACCELERATION, SIGMA, MAX_SPEED = 2.5, 1.0, 0.5, 25.0
"""Of all cars, with a reaction time of 1 s."""

_CROWDED = 3.0
"""A draw with a number beyond this comes within three quarters of the time, or less."""

CLEARANCE = 0.1
"""From the start of the road to a car that enters [m]."""

_CHECKS = "collision leaderGap followerGap junction stop arrivalSpeed speedLimit"
"""All of SUMO's that apply but one: it would drop cars that enter a short road on a lane from which
they cannot change, and the demand would depend on the length. Such cars brake for their turn."""

APPROACHES = ("W", "N", "E", "S")
"""In the order of the observation, and clockwise: the exit after next lies straight ahead."""


def crowded_share(n: int) -> float:
    """Probability of a crowded draw of n cars: its largest number is beyond `_CROWDED`."""
    return float(-np.expm1(n * np.log1p(-np.exp(-(_CROWDED**SHAPE)))))


def departures(
    rng: np.random.Generator, n: int, seconds: int, *, crowded: bool | None = None
) -> Array:
    """(n,) sorted departure times, whole seconds in 0..seconds; n >= 2.

    Args:
        rng: draws them.
        n: number of cars.
        seconds: length of the episode.
        crowded: only a draw that is, or is not; None: as it comes.
    """
    draws = np.sort(rng.weibull(SHAPE, n))
    while crowded is not None and bool(draws[-1] > _CROWDED) is not crowded:
        draws = np.sort(rng.weibull(SHAPE, n))
    low, high = np.floor(draws[1]), np.ceil(draws[-1])
    stretched: Array = (draws - low) / (high - low) * seconds
    return np.clip(np.rint(stretched), 0, seconds)


def directions(rng: np.random.Generator, n: int) -> list[tuple[str, str]]:
    """(approach, exit) of n cars: straight on, or left and right alike."""
    straight = rng.random(n) < STRAIGHT_SHARE
    entry = rng.integers(4, size=n)
    turn = np.where(rng.integers(2, size=n) == 0, 1, 3)
    leave = (entry + np.where(straight, 2, turn)) % 4
    return [(APPROACHES[i], APPROACHES[j]) for i, j in zip(entry, leave, strict=True)]


def entry_speed(speed_limit: float) -> float:
    """Speed with which cars enter [m/s]."""
    return min(10.0, speed_limit)


def stopping_distance(speed: float) -> float:
    """Road [m] that a car entering at `speed` fills: itself, a step of reaction, steps of braking.

    SUMO drops cars that enter a road which is not longer.
    """
    steps = int(speed / DECELERATION)
    braking = steps * speed - DECELERATION * steps * (steps + 1) / 2.0
    return LENGTH + CLEARANCE + speed + braking


def routes(
    rng: np.random.Generator,
    n: int,
    seconds: int,
    speed_limit: float,
    *,
    crowded: bool | None = None,
) -> str:
    """XML of one episode's cars; arguments as in `departures`."""
    ways = "".join(
        f'<route id="{a}{b}" edges="{a}_in {b}_out"/>'
        for a in APPROACHES
        for b in APPROACHES
        if a != b
    )
    times = departures(rng, n, seconds, crowded=crowded).tolist()
    cars = "".join(
        f'<vehicle id="{k}" type="car" route="{a}{b}" depart="{time:.0f}" departLane="random" '
        f'departSpeed="{entry_speed(speed_limit):g}" insertionChecks="{_CHECKS}"/>'
        for k, (time, (a, b)) in enumerate(zip(times, directions(rng, n), strict=True))
    )
    kind = (
        f'<vType id="car" carFollowModel="Krauss" accel="{ACCELERATION:g}" '
        f'decel="{DECELERATION:g}" length="{LENGTH:g}" minGap="{MIN_GAP:g}" sigma="{SIGMA:g}" '
        f'tau="1" maxSpeed="{MAX_SPEED:g}" '
        f'speedFactor="1" speedDev="0"/>'
    )
    return f"<routes>{kind}{ways}{cars}</routes>"
