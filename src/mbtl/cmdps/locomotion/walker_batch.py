"""Many walkers, each in a context of its own, as a batch of the engine.

A simulation is known to the engine by the number of its walker (`walker_herd`), which no other
process understands: a training that is interrupted begins again.
"""

from __future__ import annotations

import functools
import os
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mbtl.arrays import Array
from mbtl.cmdps.contextual import TimeLimit
from mbtl.cmdps.locomotion.walker_body import N_FEATURES, N_MOTORS, N_NOISE, STANCE
from mbtl.cmdps.locomotion.walker_herd import Herd, LocalHerd, SharedHerd
from mbtl.processes import native_threads
from mbtl.worlds import Box

_MOTORS = Box((-1.0,) * N_MOTORS, (1.0,) * N_MOTORS)


class WalkerParams(NamedTuple):
    """`walker_body.Constants`, and what a policy sees of the context."""

    gravity: Any
    friction: Any
    scale: Any
    visible: Any


@dataclass(frozen=True)
class BipedalWalkers:
    """`walker.BipedalWalker` in batches (`mbtl.worlds.hosted.Batch`)."""

    horizon: int = 1000
    time_limit: TimeLimit = "truncation"
    action: Box = _MOTORS
    idle: tuple[float, ...] = STANCE

    shapes: ClassVar[tuple[tuple[str, tuple[int, ...]], ...]] = (("walker", ()),)
    n_features: ClassVar[int] = N_FEATURES
    n_noise: ClassVar[int] = N_NOISE
    max_return: ClassVar[float | None] = None
    params: ClassVar[type[WalkerParams]] = WalkerParams
    storable: ClassVar[bool] = False

    def initial(self, noise: Array, params: WalkerParams) -> tuple[dict[str, Any], Any]:
        """New walkers."""
        axes = noise.shape[:-1]
        constants = np.stack([np.reshape(x, -1) for x in params[:-1]], axis=-1)
        numbers, seen = self._herd.start(constants, noise.reshape(-1, N_NOISE))
        return {"walker": numbers.reshape(axes)}, seen.reshape(*axes, N_FEATURES)

    def step(
        self, state: Any, action: Array, params: WalkerParams
    ) -> tuple[dict[str, Any], Any, Any, Any]:
        """One action of every walker."""
        axes = action.shape[:-1]
        numbers = np.asarray(state["walker"]).reshape(-1).astype(np.int64)
        moved = self._herd.step(numbers, action.reshape(-1, N_MOTORS).astype(np.float32))
        seen, reward, ended, after = (x.reshape(*axes, *x.shape[1:]) for x in moved)
        return {"walker": after}, seen, reward, ended

    @property
    def _herd(self) -> Herd:
        return _herd(self.horizon, native_threads(), os.getpid())


@functools.lru_cache(maxsize=8)
def _herd(horizon: int, processes: int, owner: int) -> Herd:
    return LocalHerd(horizon) if processes == 1 else SharedHerd(horizon, processes)
