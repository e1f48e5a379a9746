"""One job: train on a context, save the policy, evaluate it everywhere. Any process can do it.

A trained policy appears in its folder by one rename before it is evaluated, so a run killed during
evaluation finds it there and trains nothing again.
"""

from __future__ import annotations

import json
import shutil
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.errors import StorageError
from mbtl.trainer import OnProgress, Trainer, checked_returns

_RECEIPT = "trained.json"


@dataclass(frozen=True)
class Job:
    """One training and its evaluation, complete in itself so that any process can do it."""

    trainer: Trainer
    context: Context
    seed: int
    targets: Sequence[Context]
    evaluation_seed: int
    folder: Path | None


@dataclass(frozen=True)
class Outcome:
    """What a job gave: checked returns (N, n_episodes), and the policy if it was not saved."""

    returns: Array
    seconds: float
    saved: bool
    policy: Any = None


def perform(
    job: Job, on_progress: OnProgress | None = None, on_trained: Callable[[], None] | None = None
) -> Outcome:
    """Train (unless the policy is there already), save, evaluate. Runs in any process."""
    started = time.perf_counter()
    policy = _trained_before(job)
    saved = policy is not None
    if policy is None:
        policy = job.trainer.train(dict(job.context), job.seed, on_progress)
        saved = _save(job, policy)
    if on_trained is not None:
        on_trained()
    returns = job.trainer.evaluate(policy, list(job.targets), job.evaluation_seed)
    checked = checked_returns(returns, len(job.targets))
    return Outcome(checked, time.perf_counter() - started, saved, None if saved else policy)


def _trained_before(job: Job) -> Any:
    """The policy of a run that was killed after training; None if there is none of this seed."""
    if job.folder is None or not (job.folder / _RECEIPT).is_file():
        return None
    receipt = json.loads((job.folder / _RECEIPT).read_text())
    return job.trainer.load(job.folder) if receipt["seed"] == job.seed else None


def _save(job: Job, policy: Any) -> bool:
    if job.folder is None:
        return False
    temporary = job.folder.with_name(f".{job.folder.name}.{uuid.uuid4().hex[:8]}")
    try:
        temporary.mkdir(parents=True)
        saved = job.trainer.save(policy, temporary)
        if saved:
            receipt = {
                "seed": job.seed,
                "context": dict(job.context),
                "format": job.trainer.policy_format,
            }
            (temporary / _RECEIPT).write_text(json.dumps(receipt))
            shutil.rmtree(job.folder, ignore_errors=True)
            temporary.rename(job.folder)
        return saved
    except OSError as error:
        raise StorageError(
            f"the policy could not be saved in {job.folder.parent} ({error.strerror or error}); "
            "what was told before is kept: free space or mend access, then run the same command "
            "again"
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
