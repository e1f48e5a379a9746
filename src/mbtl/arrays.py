"""The array type of the core: float64 everywhere, shapes in the docstrings."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def uniform_weights(n: int) -> Array:
    """(n,) equal target weights, sum 1."""
    return np.full(n, 1.0 / n)
