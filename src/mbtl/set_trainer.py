"""The contract of trainers that also train one policy on several contexts, counted in steps.

And what counts in episodes, in steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from mbtl.contexts import Context
from mbtl.errors import InvalidInput
from mbtl.trainer import OnProgress, Progress, Reached, SteppingTrainer


@runtime_checkable
class SetTrainer(SteppingTrainer, Protocol):
    """A stepping trainer that can also train one policy on several contexts."""

    def check_on_set(self) -> None:
        """Refuse, before anything is spent, what this one cannot do.

        Raises:
            InvalidInput: its recipe cannot be learnt on several contexts.
        """
        ...

    def train_on_steps(
        self,
        contexts: Sequence[Context],
        seed: int,
        steps: int,
        *,
        marks: Sequence[int],
        saved: Path | None = None,
        on_progress: OnProgress | None = None,
    ) -> Reached:
        """As `train_steps`, but each episode may be in another one of these contexts.

        Args:
            contexts: two or more.
            seed: of the training.
            steps: in all, 1..marks[-1]; of a trainer that counts episodes, episodes.
            marks: where it may pause, likewise, rising; schedules may follow them.
            saved: as in `train_steps`.
            on_progress: told now and then.
        """
        ...


def check_counted(trainer: Any) -> None:
    """Refuse to train on several contexts by a recipe that counts episodes.

    Raises:
        InvalidInput: it does.
    """
    if trainer.timesteps is None:
        raise InvalidInput(
            "one policy for several contexts is paid in steps by recipes that count steps, got "
            f"one of {trainer.episodes} episodes; give timesteps, or choose another strategy, such "
            "as 'pilot'"
        )


def in_steps(on_progress: OnProgress | None, played: Callable[[], int]) -> OnProgress | None:
    """Reports of a training that counts episodes, in the environment steps `played` so far."""
    if on_progress is None:
        return None

    def told(progress: Progress) -> None:
        steps = played()
        total = round(steps * progress.total / max(progress.step, 1))
        on_progress(replace(progress, step=steps, total=total, unit="steps"))

    return told
