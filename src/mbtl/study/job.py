"""One job: train, save the policy, evaluate it; or only that. Any process can do it.

A trained policy is kept, durably, before it is evaluated. So whatever ends a job after its
training, its policy is found by whoever does the job next, and nothing is trained again.
"""

from __future__ import annotations

import pickle
import shutil
import tempfile
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.errors import InvalidInput, MbtlError, MissingExtra, StorageError, TrainingPruned
from mbtl.faults import FAULTS, REASON, TookTooLong, harmless, located, reason_of, traceback_of
from mbtl.study.artifacts import Artifact, ArtifactStore, FolderStore, scratch
from mbtl.study.time_limits import at_most
from mbtl.trainers.contract import (
    CountingTrainer,
    FunctionTrainer,
    OnProgress,
    Progress,
    RehearsingTrainer,
    Trainer,
    checked_returns,
    equipment_of,
    recipe_digest,
)

NOT_THE_TRAININGS_FAULT = (StorageError, InvalidInput, MissingExtra)
"""Raised as they are: the pick is given back, to be done once the cause is mended."""

ALONE = (
    "here: the policy is in the memory of this process alone, and another process would train it "
    "again"
)
_LOST = "to train it again: its worker process could not send the policy back either"
"""What to do with a policy that is saved nowhere, after "run again"."""

Stage = Literal["training", "saving", "loading", "evaluation"]


@dataclass(frozen=True)
class Kept:
    """A trained policy, and where it is safe.

    Attributes:
        policy: itself.
        artifact: where it is safe; None: nowhere so far.
        steps: environment steps of its training; None: unknown.
        state: where the state of its training is, to go on from exactly; None: nowhere.
    """

    policy: Any
    artifact: Artifact | None = None
    steps: float | None = None
    state: Artifact | None = None


@dataclass(frozen=True)
class Job:
    """One training and its evaluation, complete in itself so that any process can do it.

    Attributes:
        trainer: does the work.
        contexts: to train on.
        seed: of the training.
        targets: to evaluate on.
        evaluation_seeds: of the episodes, one per target.
        store: keeps the policy; None: it cannot be kept.
        places: in the store, where others may have left the policy, or an unfinished training of
            it; the last one is where it is to be written, and nobody else writes there.
        kept: the policy, where it was trained before in this process and could not be saved.
        rehearse: no evaluation of this study has succeeded yet, so a short one goes first.
        spools: where the policy waits while the store cannot be written, best first.
        timeout: seconds for all of it; None: no limit.
        start: the policy to begin with; None: from scratch. With a state where its own training
            goes on, or the trainer inherits; else the training begins with the weights.
        done: units that its training has had, where it goes on.
        length: units of the training in all; 0: `start` is only evaluated; None: a whole one.
        keeps_state: the training may go on later, so its state is kept.
        counts_steps: the steps of evaluations are counted, where the trainer can.
        untrained: a policy that is not trained will do: it is to be seen whether all else works.
    """

    trainer: Trainer
    contexts: Sequence[Context]
    seed: int
    targets: Sequence[Context]
    evaluation_seeds: Sequence[int]
    store: ArtifactStore | None
    places: Sequence[str] = ("",)
    kept: Kept | None = None
    rehearse: bool = False
    spools: tuple[FolderStore, ...] = ()
    timeout: float | None = None
    start: Kept | None = None
    done: float = 0.0
    length: float | None = None
    keeps_state: bool = False
    counts_steps: bool = False
    untrained: bool = False

    @property
    def place(self) -> str:
        """Where the policy is to be written."""
        return self.places[-1]


@dataclass(frozen=True)
class Outcome:
    """What a job gave.

    Attributes:
        returns: (T, n_episodes), checked.
        seconds: wall time.
        kept: the policy, or where it is.
        evaluation_steps: environment steps of the evaluation; None: not counted.
    """

    returns: Array
    seconds: float
    kept: Kept
    evaluation_steps: float | None = None


@dataclass(frozen=True)
class Trouble:
    """Why a job gave no returns.

    Attributes:
        stage: what went wrong; after the training, the policy is there.
        reason: the error in one line.
        traceback: where it came from.
        error: the exception; of another process, only our own travel.
        kept: the policy, once it is trained: then only the rest is to be done again.
        steps: environment steps that the training had; None: not known.
    """

    stage: Stage
    reason: str
    traceback: str
    error: BaseException | None = None
    kept: Kept | None = None
    steps: float | None = None

    @property
    def pruned(self) -> bool:
        """True where the training was ended early on purpose."""
        return isinstance(self.error, TrainingPruned)


def perform(
    job: Job,
    on_progress: OnProgress | None = None,
    on_kept: Callable[[Kept], None] = lambda kept: None,
    on_evaluation: Callable[[], None] = lambda: None,
    on_stuck: Callable[[], None] | None = None,
) -> Outcome | Trouble:
    """Train (unless the policy is there already), save, evaluate. Runs in any process.

    A job of length 0 evaluates only.

    Args:
        job: what to do.
        on_progress: told by the training.
        on_kept: given the policy at once, so that not even an interrupt loses it, and again when
            it is saved.
        on_evaluation: called when the policy is trained and saved.
        on_stuck: called from another thread where the job does not end at its time limit.
    """
    started = time.perf_counter()
    goes_on = job.done and job.start is not None and isinstance(job.trainer, FunctionTrainer)
    before = job.start.steps if job.start is not None and goes_on else 0.0  # a function's own count
    kept, steps = job.kept, _Steps(on_progress, before)
    stage: Stage = "training" if kept is None else "saving"
    try:
        with at_most(job.timeout, on_stuck):
            if job.length == 0.0:
                stage = "loading"
                kept = Kept(_begun_with(job), Artifact("", ""))
            if kept is None and (found := _left(job)) is not None:
                stage, kept = "loading", Kept(None, found[1])
                kept = _found(job, *found)
            if kept is None:
                kept = _trained(job, steps)
                on_kept(kept)
            if kept.artifact is None:
                stage = "saving"
                kept = replace(kept, state=_save_state(job) or kept.state)
                kept = replace(kept, artifact=_save(job, kept))
                on_kept(kept)
                _forget_partial(job)
            on_evaluation()
            if job.rehearse and job.length != 0.0 and kept.artifact is not None:
                stage = "loading"  # what cannot be read back is found out with the first policy
                kept = replace(kept, policy=job.trainer.load(_folder(job, kept.artifact)))
            stage = "evaluation"
            if job.rehearse and len(job.targets) > 2:
                _evaluated(job, kept.policy, every=len(job.targets) - 1)
            returns, played = _evaluated(job, kept.policy)
    except (TrainingPruned, TookTooLong) as error:
        return Trouble(stage, harmless(str(error), REASON), "", error, kept, steps.done)
    except FAULTS as error:
        return Trouble(stage, reason_of(error), traceback_of(error), error, kept, steps.done)
    seconds = time.perf_counter() - started
    kept = replace(kept, policy=None) if kept.artifact else kept
    return Outcome(returns, seconds, kept, played)


class _Steps:
    """Passes reports of a training on, and keeps the number of environment steps.

    Args:
        on_progress: told them.
        before: steps that are in no report, though the training has had them; None: unknown.
    """

    def __init__(self, on_progress: OnProgress | None, before: float | None) -> None:
        self._tell, self._before = on_progress, before
        self.done: float | None = None

    def __call__(self, progress: Progress) -> None:
        if progress.unit == "steps" and self._before is not None:
            self.done = self._before + float(progress.step)
        if self._tell is not None:
            self._tell(progress)


def perform_elsewhere(job: Job) -> Outcome | Trouble:
    """As `perform`, for a worker process: what it gives back can travel, whatever was raised."""
    outcome = perform(job)
    if isinstance(outcome, Trouble):
        if not isinstance(outcome.error, MbtlError):
            outcome = replace(outcome, error=None)
        elif outcome.stage == "saving" and not _can_travel(outcome.kept):
            outcome.error.args = (str(outcome.error).replace(ALONE, _LOST),)
            outcome = replace(outcome, kept=None)
        if outcome.kept is not None and outcome.kept.artifact is not None:
            outcome = replace(outcome, kept=replace(outcome.kept, policy=None))
    return outcome


def _can_travel(kept: Kept | None) -> bool:
    try:
        pickle.dumps(kept)
    except Exception:  # of whatever the policy consists of
        return False
    return True


def rehearse(
    trainer: RehearsingTrainer,
    targets: Sequence[Context],
    seeds: Sequence[int],
    timeout: float | None = None,
) -> Trouble | None:
    """Save, load and evaluate an untrained policy; what went wrong, or None.

    A slip in `evaluate` costs seconds here, and a training where it is found out later.

    Args:
        trainer: can make an untrained policy.
        targets: a few contexts.
        seeds: of their evaluations.
        timeout: seconds that it may take; None: no limit.
    """
    with tempfile.TemporaryDirectory() as folder:
        job = Job(
            trainer, targets[:1], 0, targets, seeds, FolderStore(Path(folder)),
            places=["policies/a/trial"], rehearse=True, timeout=timeout, untrained=True,
        )  # fmt: skip
        outcome = perform_elsewhere(job)
    return None if isinstance(outcome, Outcome) else outcome


def _evaluated(job: Job, policy: Any, every: int = 1) -> tuple[Array, float | None]:
    """Checked returns on all targets, or every so many, and, where counted, the episodes' steps."""
    trainer, targets, seeds = job.trainer, job.targets[::every], job.evaluation_seeds[::every]
    steps = None
    if job.counts_steps and isinstance(trainer, CountingTrainer):
        returns, lasted = trainer.evaluate_steps(policy, targets, seeds)
        steps = float(np.sum(lasted))
    else:
        returns = trainer.evaluate(policy, targets, seeds)
    checked = checked_returns(returns, len(targets), targets)
    return checked, steps if steps == steps else None


def _left(job: Job) -> tuple[ArtifactStore, Artifact, Mapping[str, Any]] | None:
    """The policy of this very training, by somebody who was ended after it, and its receipt."""
    wanted = _made_with(job).items()
    stores = () if job.store is None else (job.store, *job.spools)
    for store, place in product(stores, reversed(job.places)):
        receipt = store.receipt(place)
        if receipt and wanted <= receipt.items() and isinstance(receipt.get("sha256"), str):
            with suppress(StorageError):  # of other files by now: no policy of this training
                store.read(place, receipt["sha256"])
                return store, Artifact(place, receipt["sha256"]), receipt
    return None


def _made_with(job: Job) -> dict[str, Any]:
    """What the receipt of a policy says of its training, by which it is found again."""
    made = equipment_of(job.trainer)
    return {"seed": job.seed, "format": made["policy_format"], "recipe": made["recipe"]}


def _folder(job: Job, artifact: Artifact) -> Path:
    assert job.store is not None
    return job.store.read(artifact.place, artifact.sha256)


def _found(job: Job, store: ArtifactStore, artifact: Artifact, receipt: Mapping[str, Any]) -> Kept:
    """What a former worker has left: the policy, and what its receipt says of the training.

    One that waits in a spool is still to be saved.
    """
    state = receipt.get("state")
    return Kept(
        job.trainer.load(store.read(artifact.place, artifact.sha256)),
        artifact if store is job.store else None,
        receipt.get("steps"),
        Artifact(*state) if isinstance(state, list) and len(state) == 2 else None,
    )


def _begun_with(job: Job) -> Any:
    """The policy to begin with; None: from scratch.

    Raises:
        InvalidInput: it was kept nowhere.
        StorageError: nor is it where it was kept.
    """
    if job.start is None:
        return None
    if job.start.policy is not None:
        return job.start.policy
    if job.start.artifact is None:
        raise InvalidInput(
            "a training begins with a policy that was kept, and this one was told without; tell it "
            "with policy= or policy_object="
        )
    folder = _folder(job, job.start.artifact)
    if not folder.is_dir():
        raise StorageError(
            f"a training begins with the policy in {folder}, and nothing is there; bring it back, "
            "or say where the study keeps its policies (artifacts=, --artifacts)"
        )
    return job.trainer.load(folder)


def _trained(job: Job, on_progress: _Steps) -> Kept:
    """From the beginning, from a policy or its training's state, or where another worker left it.

    A state that is not there, or not as it was told, is as none: then it begins with the weights.
    """
    if job.untrained:
        assert isinstance(job.trainer, RehearsingTrainer)
        with located(job.contexts[0]):
            return Kept(job.trainer.untrained(job.contexts[0]))
    own, *others = (*_partials(job), None)
    left = next((file for file in others if file is not None and file.exists()), None)
    state = None if job.start is None else job.start.state
    if left is None and state is not None and "state" in job.trainer.takes:
        with suppress(StorageError):
            kept = _states(job).read(state.place, state.sha256)
            left = next(iter(kept.glob(_STATE)), None)
    if own is not None and left is not None and not own.exists():
        with suppress(OSError):
            _copy_whole(left, own)
    trained = job.trainer.train(
        [dict(context) for context in job.contexts],
        job.seed,
        start=_begun_with(job),
        length=job.length,
        done=job.done,
        state=own,
        on_progress=on_progress,
    )
    steps = None if trained.steps is None else float(trained.steps)
    if steps is None and (not job.done or isinstance(job.trainer, FunctionTrainer)):
        steps = on_progress.done
    return Kept(trained.policy, None, steps)


def _copy_whole(source: Path, target: Path) -> None:
    """Copy a file or folder; whoever is ended meanwhile leaves nothing at `target`."""
    unfinished = target.with_name(f".{target.name}.{uuid.uuid4().hex[:8]}")
    try:
        (shutil.copytree if source.is_dir() else shutil.copyfile)(source, unfinished)
        unfinished.rename(target)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.unlink(missing_ok=True)


_STATE = "state"
"""Name of the state of a training in its artifact."""


def _save_state(job: Job) -> Artifact | None:
    """Keep the state of a training that may go on; None: there is none, or no place for it."""
    own = next(iter(_partials(job)), None)
    if not job.keeps_state or own is None or not own.exists():
        return None

    def fill(folder: Path) -> bool:
        _copy_whole(own, folder / _STATE)
        return True

    try:
        return _states(job).write(f"{job.place}.state", fill, {"seed": job.seed})
    except (StorageError, OSError):  # it can go on from its weights, too
        return None


def _partials(job: Job) -> list[Path]:
    """Files of unfinished trainings of this recipe and seed: one's own, then the latest of others.

    One that failed is begun again with another seed, and from the beginning.
    """
    takes, store = job.trainer.takes, _states(job)
    resumes = "resume" in takes and job.store is not None
    if not (resumes or (job.keeps_state and "state" in takes)):
        return []
    made = f"{recipe_digest(equipment_of(job.trainer))}-{job.seed}"
    places = [f"{place}.{made}" for place in reversed(job.places)]
    return [store.partial(place) or scratch("states") / place.replace("/", "-") for place in places]


def _states(job: Job) -> ArtifactStore:
    """What keeps the states of trainings; of a study in memory a folder of this process."""
    return FolderStore(scratch("states")) if job.store is None else job.store


def _forget_partial(job: Job) -> None:
    for file in _partials(job):
        with suppress(OSError):
            shutil.rmtree(file) if file.is_dir() else file.unlink(missing_ok=True)


def _save(job: Job, kept: Kept) -> Artifact | None:
    """Keep it in the store; where that cannot be written it waits in a spool, for the next run."""
    if job.store is None:
        return None
    fill, contexts = partial(job.trainer.save, kept.policy), [dict(c) for c in job.contexts]
    receipt = {**_made_with(job), "contexts": contexts, "steps": kept.steps}
    if kept.state is not None:
        receipt["state"] = [kept.state.place, kept.state.sha256]
    try:
        safe = job.store.write(job.place, fill, receipt)
    except (StorageError, OSError) as error:
        waits = _spooled(job, fill, receipt)
        then = f"again {ALONE}"
        if waits:
            then = f"the same command again: it waits in {waits}, and is not trained again"
        why = getattr(error, "strerror", None) or error
        raise StorageError(
            f"the policy could not be saved in {job.place} ({why}); free space or mend access, "
            f"then run {then}"
        ) from error
    except NOT_THE_TRAININGS_FAULT:
        raise
    except FAULTS as error:
        then = "" if job.untrained else f", then run again {ALONE}"
        raise StorageError(
            f"the policy could not be saved, save raised {reason_of(error)}; mend save{then}"
        ) from error
    for spool in job.spools:
        for place in job.places:
            spool.remove(place)
    return safe


def _spooled(job: Job, fill: Callable[[Path], bool], receipt: Mapping[str, Any]) -> Path | None:
    """Where the policy waits; None: it could be saved nowhere."""
    for spool in job.spools:
        with suppress(Exception):  # the next one may do
            if spool.write(job.place, fill, receipt) is not None:
                for place in job.places[:-1]:  # where it has waited before
                    spool.remove(place)
                return spool.read(job.place)
        with suppress(OSError):  # folders that are empty now
            for folder in list(Path(spool.root, job.place).parents)[:4]:
                folder.rmdir()
    return None
