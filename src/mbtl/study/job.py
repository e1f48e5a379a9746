"""One job: train on a context, save the policy, evaluate it. Any process can do it.

A trained policy appears in its folder by one rename, and is on the disk, before it is evaluated. So
whatever ends a job after its training, its policy is found there and nothing is trained again.
"""

from __future__ import annotations

import json
import shutil
import time
import traceback
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.errors import InvalidInput, MissingExtra, StorageError
from mbtl.files import sync_entries, sync_folder
from mbtl.trainer import OnProgress, Trainer, checked_returns, equipment_of

NOT_THE_TRAININGS_FAULT = (StorageError, InvalidInput, MissingExtra)
"""Raised as they are: the pick is given back, to be done once the cause is mended."""

Stage = Literal["training", "saving", "loading", "evaluation"]

_RECEIPT = "trained.json"
_LONGEST = 8000
"""Characters of a traceback that are kept: its end, which says what happened."""


@dataclass(frozen=True)
class Kept:
    """A trained policy, and whether it is safe in its folder."""

    policy: Any
    saved: bool = False


@dataclass(frozen=True)
class Job:
    """One training and its evaluation, complete in itself so that any process can do it.

    Attributes:
        trainer: does the work.
        context: to train on.
        seed: of the training.
        targets: to evaluate on.
        evaluation_seed: of the episodes.
        folder: where the policy is kept; None: it cannot be.
        kept: the policy, where it was trained before in this process and could not be saved.
        rehearse: no evaluation of this study has succeeded yet, so a short one goes first.
    """

    trainer: Trainer
    context: Context
    seed: int
    targets: Sequence[Context]
    evaluation_seed: int
    folder: Path | None
    kept: Kept | None = None
    rehearse: bool = False


@dataclass(frozen=True)
class Outcome:
    """What a job gave: checked returns (N, n_episodes), and the policy if it was not saved."""

    returns: Array
    seconds: float
    saved: bool
    policy: Any = None


@dataclass(frozen=True)
class Trouble:
    """Why a job gave no returns.

    Attributes:
        stage: what went wrong; after the training, the policy is there.
        reason: the error in one line.
        traceback: where it came from.
        error: the exception; of another process, only our own travel.
        kept: the policy, once it is trained: then only the rest is to be done again.
    """

    stage: Stage
    reason: str
    traceback: str
    error: Exception | None = None
    kept: Kept | None = None


def perform(
    job: Job,
    on_progress: OnProgress | None = None,
    on_kept: Callable[[Kept], None] = lambda kept: None,
    on_evaluation: Callable[[], None] | None = None,
) -> Outcome | Trouble:
    """Train (unless the policy is there already), save, evaluate. Runs in any process.

    Args:
        job: what to do.
        on_progress: told by the training.
        on_kept: given the policy at once, so that not even an interrupt loses it, and again when
            it is saved.
        on_evaluation: called when the policy is trained and saved.
    """
    started = time.perf_counter()
    stage, kept = _first_stage(job), job.kept
    try:
        if stage == "loading":
            kept = Kept(None, saved=True)
            kept = Kept(job.trainer.load(_folder(job)), saved=True)
        if kept is None:
            kept = Kept(job.trainer.train(dict(job.context), job.seed, on_progress))
            on_kept(kept)
        if not kept.saved:
            stage = "saving"
            kept = replace(kept, saved=_save(job, kept.policy))
            on_kept(kept)
        if on_evaluation is not None:
            on_evaluation()
        if job.rehearse and kept.saved:
            stage = "loading"  # a policy that cannot be read back is found out with the first one
            kept = Kept(job.trainer.load(_folder(job)), saved=True)
        stage = "evaluation"
        if job.rehearse and len(job.targets) > 2:
            ends = (job.targets[0], job.targets[-1])
            evaluated(job.trainer, kept.policy, ends, job.evaluation_seed)
        returns = evaluated(job.trainer, kept.policy, job.targets, job.evaluation_seed)
    except Exception as error:
        return Trouble(stage, reason_of(error), _traceback(error), error, kept)
    seconds = time.perf_counter() - started
    return Outcome(returns, seconds, kept.saved, None if kept.saved else kept.policy)


def perform_elsewhere(job: Job) -> Outcome | Trouble:
    """As `perform`, for a worker process: what it gives back can travel, whatever was raised."""
    outcome = perform(job)
    if isinstance(outcome, Trouble):
        if not isinstance(outcome.error, NOT_THE_TRAININGS_FAULT):
            outcome = replace(outcome, error=None)
        if outcome.kept is not None and outcome.kept.saved:
            outcome = replace(outcome, kept=Kept(None, saved=True))
    return outcome


def evaluated(trainer: Trainer, policy: Any, targets: Sequence[Context], seed: int) -> Array:
    """Checked returns (n_targets, n_episodes) of a policy."""
    return checked_returns(trainer.evaluate(policy, list(targets), seed), len(targets))


def reason_of(error: Exception) -> str:
    """An exception in one line."""
    return f"{type(error).__name__}: {error}"


def _first_stage(job: Job) -> Stage:
    """Where a job begins: a run that was ended after the training left a policy of this seed."""
    if job.kept is not None:
        return "saving"
    if job.folder is None or not (job.folder / _RECEIPT).is_file():
        return "training"
    try:
        receipt = json.loads((job.folder / _RECEIPT).read_text())
        made = equipment_of(job.trainer)
        same = receipt["seed"] == job.seed and receipt["format"] == made["policy_format"]
        same = same and receipt.get("recipe", made["recipe"]) == made["recipe"]
        return "loading" if same else "training"
    except (OSError, ValueError, KeyError, TypeError):  # not written by us: no policy of this job
        return "training"


def _folder(job: Job) -> Path:
    assert job.folder is not None
    return job.folder


def _save(job: Job, policy: Any) -> bool:
    if job.folder is None:
        return False
    temporary = job.folder.with_name(f".{job.folder.name}.{uuid.uuid4().hex[:8]}")
    try:
        temporary.mkdir(parents=True)
        saved = job.trainer.save(policy, temporary)
        if saved:
            made = equipment_of(job.trainer)
            receipt = {"seed": job.seed, "context": dict(job.context)}
            receipt |= {"format": made["policy_format"], "recipe": made["recipe"]}
            (temporary / _RECEIPT).write_text(json.dumps(receipt))
            sync_folder(temporary)
            shutil.rmtree(job.folder, ignore_errors=True)
            temporary.rename(job.folder)
            for place in list(job.folder.parents)[:3]:  # the study's own is the third
                sync_entries(place)
        return saved
    except NOT_THE_TRAININGS_FAULT:
        raise
    except OSError as error:
        raise StorageError(
            f"the policy could not be saved in {job.folder.parent} ({error.strerror or error}); "
            "what was told before is kept: free space or mend access, then run the same command "
            "again"
        ) from error
    except Exception as error:
        raise StorageError(
            f"the trained policy could not be saved, save raised {reason_of(error)}; what was told "
            "before is kept: mend save, then run again"
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _traceback(error: Exception) -> str:
    """As Python prints it, without our own frame at its beginning."""
    below = error.__traceback__.tb_next if error.__traceback__ else None
    text = "".join(traceback.format_exception(type(error), error, below or error.__traceback__))
    return text if len(text) <= _LONGEST else "...\n" + text[-_LONGEST:]
