"""The settings of a study, as they are stored with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, StorageError
from mbtl.objective import Bounds, Direction
from mbtl.selectors.base import SelectionProblem


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
        target_steps: of an evaluation on one target, at most; None likewise.
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
            budget=self.budget,
            theta=self.theta,
            costs=None if self.costs is None else np.asarray(self.costs, dtype=np.float64),
            cost_budget=self.cost_budget,
            risk=self.risk,
            least_left=self.stop_left,
            abilities=abilities if self.any_training else None,
            assumed=assumed,
        )

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
    Bounds(*(spec.bounds or (0.0, 1.0)), spec.direction)
    spec.selection_problem()
    if spec.steps is not None and None in (spec.unit, spec.target_steps):
        raise InvalidInput("a study that counts steps must know those of a unit and of a target")
    if spec.eval_targets is not None and not 1 <= spec.eval_targets <= spec.space.n:
        raise InvalidInput(
            f"policies are evaluated on 1 to {spec.space.n} targets, got {spec.eval_targets}"
        )
