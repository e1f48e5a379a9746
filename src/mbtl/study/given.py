"""Settings of a study as they were given: made plain, or refused with the rule that they break.

Each function raises `InvalidInput`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from numpy.typing import ArrayLike

from mbtl.contexts import Context, ContextSpace
from mbtl.errors import InvalidInput
from mbtl.objective import Bounds
from mbtl.plain import float_of, floats, short, whole
from mbtl.selectors import SelectionProblem, Selector
from mbtl.selectors.contract import traits_of


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


def any_given(settings: Iterable[object]) -> bool:
    """Whether one of them is not None."""
    return any(setting is not None for setting in settings)


def check_paid_in_steps(alone: bool) -> None:
    """Settings of studies that are paid in trainings mean nothing to a strategy."""
    if not alone:
        raise InvalidInput(
            "with cost='steps' a strategy decides, so selector, objective, stopping rules, costs, "
            "risk and eval_targets mean nothing; leave them out, and give strategy="
        )


def check_paid_in_trainings(cost: str, of_steps: Mapping[str, object]) -> None:
    """What is counted, and settings that need another count."""
    if cost != "trainings":
        raise InvalidInput(f"a budget counts 'trainings' or 'steps', got cost={cost!r}")
    for name, setting in of_steps.items():
        if setting is not None:
            raise InvalidInput(
                f"{name} belongs to a study that is paid in steps, got {short(setting)}; add "
                "cost='steps', or leave it out"
            )


def check_wishes(
    selector: Selector,
    stop_gain: float | None,
    stop_confidence: float,
    bounds: tuple[float, float] | Bounds | None,
) -> None:
    """The stopping rule needs a selector that knows of it."""
    if not stop_confidence < 1.0:
        raise InvalidInput(f"stop_confidence is a probability in (0, 1), got {stop_confidence!r}")
    if stop_gain is None:
        return
    if bounds is None:
        raise InvalidInput("stop_gain is in performance, so it needs bounds=(low, high); got none")
    if not traits_of(selector).predicts_chances:
        raise InvalidInput(
            f"stop_gain needs a selector that predicts chances of a gain, such as 'auto', got "
            f"{selector.name!r}"
        )


def check_axes(selector: Selector, problem: SelectionProblem) -> None:
    """Contexts on several axes are not for every selector."""
    if traits_of(selector).one_axis:
        _ = problem.line  # refuses others


def target_count(count: int | None, n: int) -> int | None:
    """A whole number from 1 to `n`, or None."""
    if count is None:
        return None
    count = whole("eval_targets", count)
    if not 1 <= count <= n:
        raise InvalidInput(f"eval_targets must be from 1 to {n}, got {count}")
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
