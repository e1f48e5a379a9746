"""MBTL as in the released code, which is not the camera-ready paper (cmdp-spec 8.2)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from mbtl.arrays import Array
from mbtl.history import History
from mbtl.models import GPSettings
from mbtl.selectors.mbtl import MBTL


@dataclass(frozen=True)
class MBTLRelease(MBTL):
    """The released rules: no warm-up, lambda = sqrt(log(n + 1)), GP noise std 0.1, incumbent >= 0.

    The GP is fitted to the best score on each source right after it was trained, so to the larger
    of its own and an earlier transferred one. Ties: the release leaves them to an unstable sort;
    here the lowest index.
    """

    warm_up: int = 0
    gp: GPSettings = field(default_factory=lambda: GPSettings(noise_std=0.1))
    name: str = "mbtl-release"
    _least: ClassVar[float] = 0.0

    def _weight(self, k: int, n: int) -> float:
        return float(np.log(k))

    def _observed(self, history: History) -> Array:
        """(k,) y_l = max over m <= l of J(pi_m, x_l): the best score on source l right after it."""
        columns = history.rows[:, np.asarray(history.sources, dtype=np.intp)]
        return np.asarray(np.diagonal(np.fmax.accumulate(columns, axis=0)).copy())
