"""One job: train on a context, save the policy, evaluate it. Any process can do it.

A trained policy is kept, durably, before it is evaluated. So whatever ends a job after its
training, its policy is found by whoever does the job next, and nothing is trained again.
"""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.errors import InvalidInput, MissingExtra, StorageError, TrainingPruned
from mbtl.faults import FAULTS, REASON, TookTooLong, harmless, reason_of, traceback_of
from mbtl.study.artifacts import RECEIPT, Artifact, ArtifactStore, FolderStore
from mbtl.study.limits import at_most
from mbtl.trainer import (
    OnProgress,
    Progress,
    Trained,
    Trainer,
    checked_returns,
    equipment_of,
    recipe_digest,
)

NOT_THE_TRAININGS_FAULT = (StorageError, InvalidInput, MissingExtra)
"""Raised as they are: the pick is given back, to be done once the cause is mended."""

Stage = Literal["training", "saving", "loading", "evaluation"]


@dataclass(frozen=True)
class Kept:
    """A trained policy, and where it is safe; None: nowhere so far."""

    policy: Any
    artifact: Artifact | None = None


@dataclass(frozen=True)
class Job:
    """One training and its evaluation, complete in itself so that any process can do it.

    Attributes:
        trainer: does the work.
        context: to train on.
        seed: of the training.
        targets: to evaluate on.
        evaluation_seeds: of the episodes, one per target.
        store: keeps the policy; None: it cannot be kept.
        place: of the policy in the store; nobody else writes there.
        former: places where others may have left the policy, or an unfinished training of it.
        kept: the policy, where it was trained before in this process and could not be saved.
        rehearse: no evaluation of this study has succeeded yet, so a short one goes first.
        spools: where the policy waits while the store cannot be written, best first.
        timeout: seconds for all of it; None: no limit.
    """

    trainer: Trainer
    context: Context
    seed: int
    targets: Sequence[Context]
    evaluation_seeds: Sequence[int]
    store: ArtifactStore | None
    place: str = ""
    former: tuple[str, ...] = ()
    kept: Kept | None = None
    rehearse: bool = False
    spools: tuple[FolderStore, ...] = ()
    timeout: float | None = None


@dataclass(frozen=True)
class Outcome:
    """What a job gave: checked returns (N, n_episodes), and the policy if it was not saved."""

    returns: Array
    seconds: float
    artifact: Artifact | None
    policy: Any = None
    steps: float | None = None


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
    error: BaseException | None = None
    kept: Kept | None = None

    @property
    def pruned(self) -> bool:
        """True where the training was ended early on purpose."""
        return isinstance(self.error, TrainingPruned)


def perform(
    job: Job,
    on_progress: OnProgress | None = None,
    on_kept: Callable[[Kept], None] = lambda kept: None,
    on_evaluation: Callable[[], None] | None = None,
    on_stuck: Callable[[], None] | None = None,
) -> Outcome | Trouble:
    """Train (unless the policy is there already), save, evaluate. Runs in any process.

    Args:
        job: what to do.
        on_progress: told by the training.
        on_kept: given the policy at once, so that not even an interrupt loses it, and again when
            it is saved.
        on_evaluation: called when the policy is trained and saved.
        on_stuck: called from another thread where the job does not end at its time limit.
    """
    started = time.perf_counter()
    kept, steps = job.kept, _Steps(on_progress)
    stage: Stage = "training" if kept is None else "saving"
    try:
        with at_most(job.timeout, on_stuck):
            if kept is None and (found := _left(job)) is not None:
                stage, kept = "loading", Kept(None, found)
                kept = Kept(job.trainer.load(_folder(job, found)), found)
            if kept is None:
                trained = _trained(job, steps)
                kept, steps.done = Kept(trained.policy), trained.steps or steps.done
                on_kept(kept)
            if kept.artifact is None:
                stage = "saving"
                kept = replace(kept, artifact=_save(job, kept.policy))
                on_kept(kept)
                _forget_partial(job)
            if on_evaluation is not None:
                on_evaluation()
            if job.rehearse and kept.artifact is not None:
                stage = "loading"  # what cannot be read back is found out with the first policy
                kept = replace(kept, policy=job.trainer.load(_folder(job, kept.artifact)))
            stage = "evaluation"
            if job.rehearse and len(job.targets) > 2:
                ends, seeds = job.targets[:: len(job.targets) - 1], job.evaluation_seeds
                evaluated(job.trainer, kept.policy, ends, seeds[:: len(seeds) - 1])
            returns = evaluated(job.trainer, kept.policy, job.targets, job.evaluation_seeds)
    except (TrainingPruned, TookTooLong) as error:
        return Trouble(stage, harmless(str(error), REASON), "", error, kept)
    except FAULTS as error:
        return Trouble(stage, reason_of(error), traceback_of(error), error, kept)
    seconds = time.perf_counter() - started
    policy = None if kept.artifact else kept.policy
    return Outcome(returns, seconds, kept.artifact, policy, steps.done)


class _Steps:
    """Passes reports of a training on, and keeps the number of environment steps."""

    def __init__(self, on_progress: OnProgress | None) -> None:
        self._tell = on_progress
        self.done: float | None = None

    def __call__(self, progress: Progress) -> None:
        if progress.unit == "steps":
            self.done = float(progress.step)
        if self._tell is not None:
            self._tell(progress)


def perform_elsewhere(
    job: Job,
    travel: tuple[type[Exception], ...] = (*NOT_THE_TRAININGS_FAULT, TrainingPruned),
) -> Outcome | Trouble:
    """As `perform`, for a worker process: what it gives back can travel, whatever was raised."""
    outcome = perform(job)
    if isinstance(outcome, Trouble):
        if not isinstance(outcome.error, travel):
            outcome = replace(outcome, error=None)
        if outcome.kept is not None and outcome.kept.artifact is not None:
            outcome = replace(outcome, kept=replace(outcome.kept, policy=None))
    return outcome


def evaluated(
    trainer: Trainer, policy: Any, targets: Sequence[Context], seeds: Sequence[int]
) -> Array:
    """Checked returns (n_targets, n_episodes) of a policy."""
    returns = trainer.evaluate(policy, list(targets), list(seeds))
    return checked_returns(returns, len(targets), lambda t: str(dict(targets[t])))


def _left(job: Job) -> Artifact | None:
    """The policy of this very training, by somebody who was ended after it.

    One that waits in a spool is brought to the store.

    Raises:
        StorageError: it is there, and the store still cannot be written.
    """
    if job.store is None:
        return None
    if (found := _left_in(job.store, job)) is not None:
        return found
    for spool in job.spools:
        if (waiting := _left_in(spool, job)) is None:
            continue
        folder = spool.read(waiting.place)
        try:
            kept = job.store.write(
                job.place, partial(_copied, folder), dict(spool.receipt(waiting.place) or {})
            )
        except (StorageError, OSError) as error:
            raise _unsaved(job, error, folder) from error
        spool.remove(waiting.place)
        return kept
    return None


def _left_in(store: ArtifactStore, job: Job) -> Artifact | None:
    """The policy of this training in one store."""
    made = equipment_of(job.trainer)
    for place in (job.place, *reversed(job.former)):
        receipt = store.receipt(place)
        if (
            receipt is not None
            and receipt.get("seed") == job.seed
            and receipt.get("format") == made["policy_format"]
            and receipt.get("recipe", made["recipe"]) == made["recipe"]
            and isinstance(receipt.get("sha256"), str)
        ):
            try:
                store.read(place, receipt["sha256"])
            except StorageError:  # of other files by now: no policy of this training
                continue
            return Artifact(place, receipt["sha256"])
    return None


def _folder(job: Job, artifact: Artifact) -> Path:
    assert job.store is not None
    return job.store.read(artifact.place, artifact.sha256)


def _trained(job: Job, on_progress: OnProgress) -> Trained:
    """From the beginning, or from where another worker has left it."""
    own, *others = (*_partials(job), None)
    left = next((file for file in others if file is not None and file.is_file()), None)
    if own is not None and left is not None and not own.is_file():
        with contextlib.suppress(OSError):
            shutil.copyfile(left, own)
    return job.trainer.train([dict(job.context)], job.seed, state=own, on_progress=on_progress)


def _partials(job: Job) -> list[Path]:
    """Files of unfinished trainings of this recipe and seed: one's own, then the latest of others.

    One that failed is begun again with another seed, and from the beginning.
    """
    if job.store is None or "resume" not in job.trainer.takes:
        return []
    made = f"{recipe_digest(equipment_of(job.trainer))}-{job.seed}"
    places = [f"{place}.{made}" for place in (job.place, *reversed(job.former))]
    found = [job.store.partial(place) for place in places]
    return [file for file in found if file is not None]


def _forget_partial(job: Job) -> None:
    for file in _partials(job):
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)


def _save(job: Job, policy: Any) -> Artifact | None:
    """Keep it in the store; where that cannot be written it waits in a spool, for the next run."""
    if job.store is None:
        return None
    made, fill = equipment_of(job.trainer), partial(job.trainer.save, policy)
    receipt = {"seed": job.seed, "context": dict(job.context)}
    receipt |= {"format": made["policy_format"], "recipe": made["recipe"]}
    try:
        kept = job.store.write(job.place, fill, receipt)
    except (StorageError, OSError) as error:
        raise _unsaved(job, error, _spooled(job, fill, receipt)) from error
    except NOT_THE_TRAININGS_FAULT:
        raise
    except FAULTS as error:
        raise StorageError(
            f"the trained policy could not be saved, save raised {reason_of(error)}; what was told "
            "before is kept: mend save, then run again"
        ) from error
    for spool in job.spools:
        spool.remove(job.place)
    return kept


def _spooled(job: Job, fill: Callable[[Path], bool], receipt: Mapping[str, Any]) -> Path | None:
    """Where the policy waits; None: it could be saved nowhere."""
    for spool in job.spools:
        with contextlib.suppress(Exception):  # the next one may do
            if spool.write(job.place, fill, receipt) is not None:
                return spool.read(job.place)
    return None


def _copied(source: Path, folder: Path) -> bool:
    shutil.copytree(source, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns(RECEIPT))
    return True


def _unsaved(job: Job, error: Exception, waits: Path | None) -> StorageError:
    kept = f"it waits in {waits}, and is not trained again" if waits else "what was told is kept"
    return StorageError(
        f"the policy could not be saved in {job.place} ({getattr(error, 'strerror', None) or error}"
        f"); {kept}: free space or mend access, then run the same command again"
    )
