"""The settings of a study, as they are stored with it, and the rules that they keep."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, StorageError
from mbtl.objective import Bounds, Direction
from mbtl.plain import short
from mbtl.selectors.base import SelectionProblem
from mbtl.study.budget import counted

LEAST_TARGETS = 2
"""On which a policy is still evaluated with the last steps."""


@dataclass(frozen=True)
class StudySpec:
    """What a study was created with; equal specs may share a study.

    Attributes:
        space: the contexts.
        budget: trainings K that the study may ask for.
        selector: registered name and settings of the selector.
        bounds: (low, high) of the returns, or None for automatic.
        direction: "maximize" or "minimize".
        theta: slope of the linear gap; None for the default.
        seed: root of the seed tree.
        trial: which repetition of the same problem this is.
        stop_value: performance V at which the study ends early; None for never.
        cost_budget: total cost at which the study ends early; None for never.
        problem: id of the CMDP or of a user's problem.
        settings: free-form JSON-able record of the training recipe.
        costs: cost of a training on each context; None where all cost the same.
        risk: share of the targets, the worst of them, that V is the mean of.
        eval_targets: targets that each policy is evaluated on; None for all.
        stop_confidence: how probable it must be that the gain is smaller.
        stop_left: gain in V that all trainings left together should be worth; None: never ends for
            that.
        best_return: no policy can return more (less, if minimised); None: not known.
        floor: return below which none is worse in performance; None: nothing is clipped.
        any_training: the selector is a strategy that asks for trainings of every kind.
        steps: environment steps, all in, that the study may spend; None: they are not counted.
        unit: of a whole training; None: they are not counted.
        target_steps: of an evaluation on one target, before there was any; None likewise.
        horizon: of the longest episode; None likewise.
    """

    space: ContextSpace
    budget: int
    selector: Mapping[str, Any]
    bounds: tuple[float, float] | None
    direction: Direction
    theta: float | None
    seed: int
    trial: int
    stop_value: float | None
    cost_budget: float | None
    problem: str
    settings: Mapping[str, Any]
    costs: tuple[float, ...] | None = None
    risk: float = 1.0
    eval_targets: int | None = None
    stop_confidence: float = 0.9
    stop_left: float | None = None
    best_return: float | None = None
    floor: float | None = None
    any_training: bool = False
    steps: int | None = None
    unit: int | None = None
    target_steps: int | None = None
    horizon: int | None = None

    def selection_problem(
        self, abilities: frozenset[str] = frozenset(), *, assumed: bool = False
    ) -> SelectionProblem:
        """What the strategy may know before any training.

        Args:
            abilities: of the trainer, beside specialists; selectors ask for none.
            assumed: whether no trainer is known so far.
        """
        return SelectionProblem.of(
            self.space,
            budget=self.budget if self.any_training else self._affordable,
            theta=self.theta,
            costs=None if self.costs is None else np.asarray(self.costs, dtype=np.float64),
            cost_budget=self.cost_budget,
            risk=self.risk,
            least_left=self.stop_left,
            abilities=abilities if self.any_training else None,
            assumed=assumed,
        )

    @property
    def _affordable(self) -> int:
        """Trainings that the budget pays for, as expected: what a selector spreads its picks by.

        Where steps are counted, the last one is evaluated on few targets if need be.
        """
        if self.cost_budget is not None and self.costs is not None:
            budget, costs = self.cost_budget, np.array(self.costs)
            each = last = float(costs[costs <= max(budget, costs.min())].mean())
        elif self.steps is not None and self.unit and self.target_steps is not None:
            budget, targets = self.steps, self.eval_targets or self.space.n
            each = self.unit + targets * self.target_steps
            last = self.unit + min(LEAST_TARGETS, targets) * self.target_steps
        else:
            return self.budget
        return min(self.budget, max(1 + int((budget - last) / each), 1))

    @property
    def in_units(self) -> bool:
        """Whether units are the budget: neither steps nor a cost."""
        return self.steps is None and self.cost_budget is None

    @property
    def size(self) -> str:
        """The budget for people: "K = 15", "2M steps", "cost 60"."""
        if self.cost_budget is not None:
            return f"cost {self.cost_budget:g}"
        return f"K = {self.budget}" if self.steps is None else f"{counted(self.steps)} steps"

    def to_json(self) -> dict[str, Any]:
        """JSON-able record; `from_json` rebuilds it."""
        record = {name: getattr(self, name) for name in self.__dataclass_fields__}
        record["space"] = self.space.to_json()
        for name in ("bounds", "costs"):
            record[name] = list(record[name]) if record[name] else None
        return record

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> StudySpec:
        """Rebuild from `to_json`; unknown keys come from a newer version."""
        unknown = set(record) - set(cls.__dataclass_fields__)
        if unknown:
            raise StorageError(
                f"this study has settings {sorted(unknown)} of a newer mbtl; upgrade it"
            )
        values = dict(record)
        values["space"] = ContextSpace.from_json(record["space"])
        for name in ("bounds", "costs"):
            values[name] = tuple(record[name]) if record.get(name) else None
        spec = cls(**values)
        check_spec(spec)
        return spec


def check_spec(spec: StudySpec) -> None:
    """Refuse settings that no study can have.

    Raises:
        InvalidInput: the first that breaks its rule.
    """
    for name, holds in _SPEC.items():
        if not holds(getattr(spec, name)):
            raise InvalidInput(f"`{name}` of a study cannot be {short(getattr(spec, name))}")
    Bounds(*(spec.bounds or (0.0, 1.0)), spec.direction)
    spec.selection_problem()
    if spec.steps is not None and None in (spec.unit, spec.target_steps, spec.horizon):
        raise InvalidInput("a study that counts steps must know those of a unit and of an episode")
    if spec.eval_targets is not None and not 1 <= spec.eval_targets <= spec.space.n:
        raise InvalidInput(
            f"policies are evaluated on {min(2, spec.space.n)} to {spec.space.n} targets, got "
            f"{spec.eval_targets}"
        )


# ---- rules -------------------------------------------------------------------------------------

_HUGE = 1e300
"""Of facts: differences of numbers below this are numbers, too."""

Rule = Callable[[Any], bool]
"""What a fact must satisfy."""


def is_whole(value: Any) -> bool:
    """A whole number >= 0 that a database can hold."""
    return is_seed(value) and bool(value < 2**63)


def is_seed(value: Any) -> bool:
    """Of any size: it is hashed."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return whole and bool(value >= 0)


def is_number(value: Any) -> bool:
    """A number, finite and not too large to be computed with."""
    plain = value.item() if isinstance(value, np.number) else value
    real = isinstance(plain, (int, float)) and not isinstance(plain, bool)
    return real and -_HUGE < plain < _HUGE


def is_text(value: Any) -> bool:
    """Letters."""
    return isinstance(value, str)


def at_least(least: float, is_one: Rule = is_number) -> Rule:
    """Rule of numbers from `least` on."""
    return lambda value: is_one(value) and value >= least


def or_null(rule: Rule) -> Rule:
    """Rule that None keeps, too."""
    return lambda value: value is None or rule(value)


def each(rule: Rule) -> Rule:
    """Rule of lists whose items keep one."""
    return lambda value: isinstance(value, (list, tuple)) and all(map(rule, value))


def is_flag(value: Any) -> bool:
    """True or false."""
    return isinstance(value, bool)


def is_record(value: Any) -> bool:
    """Names with values."""
    return isinstance(value, Mapping)


is_count = at_least(1, is_whole)

_SPEC: dict[str, Rule] = {
    "budget": lambda one: is_whole(one) or (type(one) is int and one < 0),  # which has its words
    "selector": lambda one: is_record(one) and is_text(one.get("name")),
    "bounds": or_null(lambda pair: len(pair) == 2 and all(map(is_number, pair))),
    "costs": or_null(each(is_number)),
    "problem": is_text,
    "settings": is_record,
    "any_training": is_flag,
    **dict.fromkeys(("seed", "trial"), is_seed),
    **dict.fromkeys(("risk", "stop_confidence"), is_number),
    **dict.fromkeys(("theta", "stop_value", "stop_left"), or_null(is_number)),
    **dict.fromkeys(("cost_budget", "best_return", "floor"), or_null(is_number)),
    "eval_targets": or_null(is_whole),
    **dict.fromkeys(("steps", "unit", "target_steps", "horizon"), or_null(is_count)),
}
