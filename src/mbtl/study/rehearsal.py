"""Before the first training: can a policy be saved, loaded and evaluated at all?

A slip in `evaluate` costs seconds here, and a training where it is found out later.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.errors import MbtlError
from mbtl.study.artifacts import FolderStore
from mbtl.study.job import Job, Outcome, Trouble, perform, perform_elsewhere
from mbtl.trainers.contract import Ability, RehearsingTrainer, Trained


def rehearse(
    trainer: RehearsingTrainer,
    targets: Sequence[Context],
    seeds: Sequence[int],
    *,
    here: bool = True,
    timeout: float | None = None,
) -> Trouble | None:
    """Save, load and evaluate an untrained policy; what went wrong, or None.

    Args:
        trainer: can make an untrained policy.
        targets: a few contexts.
        seeds: of their evaluations.
        here: this process asks; False in a worker process.
        timeout: seconds that it may take; None: no limit.
    """
    with tempfile.TemporaryDirectory() as folder:
        store = FolderStore(Path(folder))
        made = _Untrained(trainer)
        job = Job(
            made, targets[:1], 0, targets, seeds, store, "policies/a/untrained", rehearse=True,
            timeout=timeout,
        )  # fmt: skip
        outcome = perform(job) if here else perform_elsewhere(job, (MbtlError,))
    return None if isinstance(outcome, Outcome) else outcome


@dataclass(frozen=True)
class _Untrained:
    """A trainer whose policies are not trained."""

    trainer: RehearsingTrainer

    takes: ClassVar[frozenset[Ability]] = frozenset()
    whole: ClassVar[int | None] = None
    counts: ClassVar[Literal["steps", "episodes"]] = "steps"

    @property
    def policy_format(self) -> str:
        return self.trainer.policy_format

    def train(self, contexts: Sequence[Context], seed: int, **asked: Any) -> Trained:
        return Trained(self.trainer.untrained(contexts[0]))

    def evaluate(self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int]) -> Array:
        return self.trainer.evaluate(policy, contexts, seeds)

    def save(self, policy: Any, folder: Path) -> bool:
        return self.trainer.save(policy, folder)

    def load(self, folder: Path) -> Any:
        return self.trainer.load(folder)
