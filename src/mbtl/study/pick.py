"""What `ask` gives: a training to do, or the news that there is none."""

from __future__ import annotations

from dataclasses import dataclass, field

from mbtl.contexts import Context
from mbtl.errors import StudyError
from mbtl.faults import harmless


class StudyFinished(StudyError):
    """There is nothing left to ask for."""


@dataclass(frozen=True)
class Pick:
    """A training to do, or a policy to evaluate further.

    Attributes:
        number: 0-based number of the pick in its study; what people are shown counts from 1.
        source: index of the context trained on; of several, the one in their middle.
        context: that context, axis name -> value.
        seed: training seed; it depends on what is trained, not on the pick number.
        reason: why the strategy chose it.
        targets: contexts worth evaluating on, their indices; None for all.
        sources: indices of all contexts trained on.
        contexts: those contexts.
        start: number of the event that told the policy to begin with (`ToldRow.event`); None: from
            scratch.
        done: units that the training has had by then, where it goes on; 0 for a new one.
        length: units that it has had in all when it is done; 0: the policy is only evaluated; None:
            a whole training, as long as the trainer has it.
        token: of its lease; who takes the pick over gets another one.
    """

    number: int
    source: int
    context: Context
    seed: int
    reason: str
    targets: tuple[int, ...] | None = None
    sources: tuple[int, ...] = ()
    contexts: tuple[Context, ...] = ()
    start: int | None = None
    done: float = 0.0
    length: float | None = None
    token: str = field(default="", compare=False)

    @property
    def trains(self) -> bool:
        """False where a policy is only evaluated."""
        return self.length != 0.0

    def __str__(self) -> str:
        where = ", ".join(f"{name} = {value}" for name, value in self.context.items())
        if len(self.sources) > 1:
            where = f"{len(self.sources)} contexts"
        return harmless(f"pick {self.number + 1}: {where} ({self.reason})")
