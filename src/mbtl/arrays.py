"""The array type of the core: float64 everywhere, shapes in the docstrings."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def uniform_weights(n: int) -> Array:
    """(n,) equal target weights, sum 1."""
    return np.full(n, 1.0 / n)


def python_value(value: Any) -> Any:
    """Python's own of a number or array of numpy: the `default` of `json.dumps`.

    Raises:
        TypeError: it is neither.
    """
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} {value!r}")
