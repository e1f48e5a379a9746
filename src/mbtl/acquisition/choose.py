"""The argmax over a finite set, with ties and exclusions (cmdp-spec 8.2)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.errors import InvalidInput

TIE = 1e-12
"""Values closer than this are equal: two exact formulas may differ in their last digits."""


def argmax_open(values: Array, mask: NDArray[np.bool_]) -> int:
    """Index of the largest value among the open ones; the lowest index on a tie.

    Raises:
        InvalidInput: nothing is open, or a value is NaN.
    """
    if not mask.any():
        raise InvalidInput("argmax needs at least one open candidate, got none")
    if np.isnan(values[mask]).any():
        raise InvalidInput("argmax needs values that are numbers, got NaN")
    open_values: NDArray[Any] = np.where(mask, values, -np.inf)
    top = open_values.max()
    return int(np.flatnonzero(open_values >= top - TIE * max(1.0, abs(float(top))))[0])
