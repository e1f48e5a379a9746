"""What `ask` gives: a source to train on, or the news that there is none."""

from __future__ import annotations

from dataclasses import dataclass, field

from mbtl.contexts import Context
from mbtl.errors import StudyError
from mbtl.faults import harmless


class StudyFinished(StudyError):
    """There is nothing left to ask for."""


@dataclass(frozen=True)
class Pick:
    """A source to train on.

    Attributes:
        number: 0-based number of the pick in its study; what people are shown counts from 1.
        source: context index.
        context: the context itself, axis name -> value.
        seed: training seed; it depends on the source, not on the pick number.
        reason: why the selector chose it.
        repeat: how many picks of this study trained on the source before.
        targets: contexts worth evaluating on, their indices; None for all.
        token: of its lease; who takes the pick over gets another one.
    """

    number: int
    source: int
    context: Context
    seed: int
    reason: str
    repeat: int = 0
    targets: tuple[int, ...] | None = None
    token: str = field(default="", compare=False)

    def __str__(self) -> str:
        where = ", ".join(f"{name} = {value}" for name, value in self.context.items())
        return harmless(f"pick {self.number + 1}: {where} ({self.reason})")
