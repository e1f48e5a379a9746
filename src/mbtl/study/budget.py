"""What a budget counts: trainings (a plain number), environment steps, or a cost of the user's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from numpy.typing import ArrayLike

from mbtl.contexts import Context
from mbtl.errors import InvalidInput
from mbtl.plain import is_finite, short, whole


@dataclass(frozen=True)
class Steps:
    """Environment steps, all in: of trainings and of evaluations.

    Attributes:
        total: steps that the study may spend.
        unit: of one whole training; None: as the trainer says.
        horizon: of the longest episode; None: the CMDP's. What an evaluation cost is known where
            the trainer counts; else each episode that it returned counts as the longest. Before the
            first, the trainer's `eval_episodes` are expected on a target, or 10.

    Raises:
        InvalidInput: one is not a whole number of 1 or more.
    """

    total: int
    unit: int | None = None
    horizon: int | None = None

    def __post_init__(self) -> None:
        for name in ("total", "unit", "horizon"):
            value = getattr(self, name)
            if value is not None or name == "total":
                whole(f"{name} of Steps", value, 1)


@dataclass(frozen=True)
class Cost:
    """A cost in the user's own unit, e.g. hours.

    Attributes:
        total: that all trainings together may cost, failed ones and each try of them, where that
            is known before.
        per_context: (N,) expected cost of a whole training on each context, or a function of the
            context (of several contexts the mean); then nothing is asked for that costs more than
            what is left, and `auto` seeks the most gain per cost. None: costs are only known when
            they are told; the study ends when they reach the total, `auto` when less is left than
            its next training costs, as the mean told says.
        trainings: at most so many units; None: as many as the cost pays for, of a selector the
            CMDP's number, or one on each context.

    Raises:
        InvalidInput: `total` is not a number > 0, or `trainings` no whole number of 1 or more.
    """

    total: float
    per_context: ArrayLike | Callable[[Context], float] | None = field(default=None, compare=False)
    trainings: int | None = None

    def __post_init__(self) -> None:
        if not (is_finite(self.total) and self.total > 0):
            raise InvalidInput(f"total of Cost is a finite number > 0, got {short(self.total)}")
        if self.trainings is not None:
            whole("trainings of Cost", self.trainings, 1)


@dataclass(frozen=True)
class Bill:
    """Environment steps of a study by what they were spent on.

    Attributes:
        training: of new trainings.
        extension: of trainings that went on.
        evaluation: of episodes of policies on targets.
        failed: of trainings that gave nothing.
        under_way: of picks that are not answered, as is expected.
    """

    training: float = 0.0
    extension: float = 0.0
    evaluation: float = 0.0
    failed: float = 0.0
    under_way: float = 0.0

    @property
    def total(self) -> float:
        """All of them."""
        return float(sum(vars(self).values()))


def counted(steps: float) -> str:
    """Steps as people say them, e.g. "1.25M"."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "K")):
        if steps >= 0.9995 * size:  # 999,600 is 1M
            return f"{steps / size:.3g}{letter}"
    return f"{steps:.0f}"
