"""Advice that nobody has learned: what drives traffic where a measurement needs the same in all.

Shared by the scripts of this folder.
"""

from __future__ import annotations

from typing import Any

PHASES = (0, 0, 0, 1, 2, 2, 2, 3)
"""Fixed times of a signal: through traffic 30 s of green, left turns 10 s, twice."""
STEADY = {"ring": 3.0, "eco": 9.0, "ramp-acc": 5.0}
"""The speed that `steady` keeps, m/s."""
LEVEL = 2
"""The level of ramp-vel that it advises, 6.7 m/s."""


def steady(family: str, obs: Any) -> Any:
    """Acceleration towards the steady speed, in numpy and jax."""
    from mbtl.zoo.cmdps.traffic import eco, ramp, ring

    if family == "ramp-vel":
        return (0.0 * obs[..., 0]).astype(int) + LEVEL
    if family == "ramp-acc":
        speed = 0.5 * (obs[..., 1:2] + 1.0) * ramp.SCALE[1]
        return (STEADY[family] - speed).clip(-1.0, 1.0)
    if family == "ring":
        speed = 0.5 * (obs[..., :1] + 1.0) * ring.SCALE[0]
        return (STEADY[family] - speed).clip(-1.0, 1.0)
    return STEADY[family] - obs[..., :1] * eco.SPEED_SCALE
