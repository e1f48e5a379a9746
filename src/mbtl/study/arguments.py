"""Settings of a study as they were given: made plain, or refused with the rule that they break.

Each function raises `InvalidInput`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from mbtl.contexts import Context, ContextSpace
from mbtl.errors import InvalidInput
from mbtl.plain import float_of, floats, is_finite, short, whole
from mbtl.selectors import SelectionProblem, Selector
from mbtl.selectors.contract import traits_of

if TYPE_CHECKING:
    from mbtl.study.create import Stopping


def costs_of(
    costs: ArrayLike | Callable[[Context], float] | None, space: ContextSpace
) -> tuple[float, ...] | None:
    """(N,) numbers, or None."""
    if costs is None:
        return None
    given = [costs(context) for context in space.contexts] if callable(costs) else costs
    try:
        array = floats(given)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInput(f"costs must be numbers, one per context ({error})") from error
    if array.shape != (space.n,):
        raise InvalidInput(f"costs must be {space.n} numbers, one per context, got {array.shape}")
    return tuple(array.tolist())


def check_stopping(selector: Selector, end: Stopping, bounds: object) -> None:
    """What is said in performance needs bounds, and a predicted gain somebody who predicts it."""
    for name in ("value", "gain", "left"):
        value = getattr(end, name)
        if value is not None and bounds is None:
            raise InvalidInput(
                f"{name} of Stopping is in performance, so it needs bounds=(low, high); got none"
            )
    if end.value is not None and is_finite(end.value) and end.value > 1.0:
        raise InvalidInput(
            f"value of Stopping is a performance, at most 1 (the better bound), got {end.value!r}"
        )
    if not (is_finite(end.confidence) and 0.0 < end.confidence < 1.0):
        raise InvalidInput(
            f"confidence of Stopping is a probability in (0, 1), got {short(end.confidence)}"
        )
    if end.gain is not None and not traits_of(selector).predicts_chances:
        raise InvalidInput(
            f"gain of Stopping needs a strategy that predicts chances of a gain, such as 'auto', "
            f"got {selector.name!r}"
        )


def check_axes(selector: Selector, problem: SelectionProblem) -> None:
    """Contexts on several axes are not for every selector."""
    if traits_of(selector).one_axis:
        _ = problem.line  # refuses others


def target_count(count: int | None, n: int) -> int | None:
    """A whole number from 1 to `n`, or None."""
    if count is None:
        return None
    count = whole("targets of Evaluation", count)
    if not 1 <= count <= n:
        raise InvalidInput(f"targets of Evaluation must be from 1 to {n}, got {count}")
    return count


def pair_of(name: str, pair: Iterable[float] | None) -> tuple[float, float] | None:
    """Two numbers, or None."""
    if pair is None:
        return None
    try:
        low, high = map(float_of, pair)
    except (TypeError, ValueError):
        low = high = None
    if low is None or high is None:
        raise InvalidInput(f"{name} must be two numbers (low, high), got {short(pair)}")
    return low, high
