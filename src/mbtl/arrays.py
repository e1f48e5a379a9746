"""The array type of the core: float64 everywhere, shapes in the docstrings."""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
Shared = TypeVar("Shared", bound=NDArray[Any] | None)


def uniform_weights(n: int) -> Array:
    """(n,) equal target weights, sum 1."""
    return np.full(n, 1.0 / n)


def unwritable(array: Shared) -> Shared:
    """The same numbers, for many to share: nobody writes into them by this name."""
    if array is None:
        return array
    view = array.view()
    view.flags.writeable = False
    return view


def python_value(value: Any) -> Any:
    """Python's own of a number or array of numpy: the `default` of `json.dumps`.

    Raises:
        TypeError: it is neither.
    """
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} {value!r}")


def plain(value: Any, array: Callable[[NDArray[Any]], Any] = np.ndarray.tolist) -> Any:
    """The value with numpy types made Python's, and NaN and infinity made None, for JSON.

    Args:
        value: dicts and lists of numbers, texts and arrays.
        array: what stands for an array.
    """
    if isinstance(value, dict):
        return {str(key): plain(item, array) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, array) for item in value]
    if isinstance(value, np.ndarray):
        return plain(array(value), array)
    if isinstance(value, np.generic):
        return plain(value.item(), array)
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
