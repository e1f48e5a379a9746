"""The settings of a study that is paid in steps, as they are stored with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbtl.actions import StepProblem
from mbtl.actions.evaluation import LEAST
from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, StorageError
from mbtl.objective import Bounds, Direction
from mbtl.plain import whole
from mbtl.selectors.base import SelectionProblem

HALVINGS_ON_ALL = 5
"""The first mark of a training on several contexts is a whole training, halved so many times."""


def lengths_on_all(lengths: Sequence[int], budget: int) -> tuple[int, ...]:
    """Marks of a training on several contexts: doublings, while the budget pays for them.

    How long it should be nobody knows beforehand, so it is not bound by a whole training of one.

    Args:
        lengths: marks of a training on one context.
        budget: environment steps of the study.
    """
    found, mark = [], -(-lengths[-1] // 2**HALVINGS_ON_ALL)
    while mark <= budget:
        found.append(mark)
        mark *= 2
    return tuple(found)


@dataclass(frozen=True)
class StepSpec:
    """What a study was opened with; equal specs may share a study.

    Attributes:
        space: the contexts.
        budget: environment steps, all in.
        strategy: its registered name and settings.
        lengths: (L,) environment steps at the marks of a training, rising; the last is a whole one.
        episodes: of a policy on a target it is evaluated on.
        horizon: most steps of an episode.
        bounds: (low, high) of the returns, or None for the range seen so far.
        direction: "maximize" or "minimize".
        floor: return below which none is worse in performance; None: nothing is clipped.
        theta: slope of the linear gap; None for the default.
        seed: root of the seed tree.
        trial: which repetition of the same problem this is.
        problem: id of the CMDP or of a user's problem.
        settings: free-form JSON-able record of the training recipe.
    """

    space: ContextSpace
    budget: int
    strategy: Mapping[str, Any]
    lengths: tuple[int, ...]
    episodes: int
    horizon: int
    bounds: tuple[float, float] | None
    direction: Direction
    floor: float | None
    theta: float | None
    seed: int
    trial: int
    problem: str
    settings: Mapping[str, Any]

    def __post_init__(self) -> None:
        for name in ("budget", "episodes", "horizon", "seed", "trial"):
            number = whole(name, getattr(self, name))
            if number < (0 if name in ("seed", "trial") else 1):
                raise InvalidInput(f"{name} must be a positive number, got {number}")
        Bounds(*(self.bounds or (0.0, 1.0)), self.direction, self.floor)
        self.problem_without(())
        least = self.lengths[0] + LEAST * self.episodes * self.horizon
        if self.budget < min(least, self.lengths[0] + self.space.n * self.episodes * self.horizon):
            raise InvalidInput(
                f"a budget pays for one short training and its evaluation at least, which is up to "
                f"{least:,} steps here, got {self.budget:,}; raise it, or choose fewer episodes or "
                "a shorter first length"
            )

    def problem_without(self, sources: tuple[int, ...], *, on_sets: bool = True) -> StepProblem:
        """What the strategy may know; on some sources nothing is begun any more.

        Without `on_sets` it may not train on several contexts.
        """
        trainable = ~np.isin(np.arange(self.space.n), sources)
        selection = SelectionProblem.of(
            self.space,
            budget=int(trainable.sum()),
            theta=self.theta,
            trainable=None if trainable.all() else trainable,
        )
        return StepProblem(
            selection,
            np.asarray(self.lengths),
            self.budget,
            self.episodes,
            self.horizon,
            np.asarray(self.lengths_on_all if on_sets else (), dtype=np.int64),
        )

    @property
    def lengths_on_all(self) -> tuple[int, ...]:
        """Marks of a training on several contexts."""
        return lengths_on_all(self.lengths, self.budget)

    def to_json(self) -> dict[str, Any]:
        """JSON-able record; `from_json` rebuilds it."""
        record = {name: getattr(self, name) for name in self.__dataclass_fields__}
        record["space"] = self.space.to_json()
        record["lengths"] = list(self.lengths)
        record["bounds"] = None if self.bounds is None else list(self.bounds)
        return record

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> StepSpec:
        """Rebuild from `to_json`; unknown keys come from a newer version."""
        unknown = set(record) - set(cls.__dataclass_fields__)
        if unknown:
            raise StorageError(
                f"this study has settings {sorted(unknown)} of a newer mbtl; upgrade it"
            )
        values = dict(record)
        values["space"] = ContextSpace.from_json(record["space"])
        values["lengths"] = tuple(int(length) for length in record["lengths"])
        values["bounds"] = None if record["bounds"] is None else tuple(record["bounds"])
        return cls(**values)
