"""Evaluations of a study that is paid in steps: charged ones on targets, and the fresh one."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbtl.actions import Policy
from mbtl.arrays import Array
from mbtl.errors import StorageError
from mbtl.seeds import Purpose, evaluation_seeds
from mbtl.study.steps.state import Fresh
from mbtl.study.storage import Conflict
from mbtl.trainer import CountingTrainer, Trainer, checked_returns, completed

if TYPE_CHECKING:
    from mbtl.study.steps.study import StepStudy


def evaluated(
    study: StepStudy,
    trainer: Trainer,
    policy: Policy,
    targets: Sequence[int],
    purpose: Purpose = Purpose.EVALUATION,
) -> tuple[Array, Array]:
    """Checked returns of a policy, and the steps of its episodes, both (T, E).

    Where nobody knows how long an episode was it counts as the longest.
    """
    weights = weights_of(study, trainer, policy)
    contexts = [study.space.context(int(t)) for t in targets]
    seeds = evaluation_seeds(study.spec.seed, study.spec.trial, targets, purpose)
    steps: Array | float = np.nan
    if isinstance(trainer, CountingTrainer):
        returns, steps = trainer.evaluate_steps(weights, contexts, seeds)
    else:
        returns = trainer.evaluate(weights, contexts, seeds)
    found = completed(checked_returns(returns, len(contexts), study.space.named(targets)))
    lasted = np.asarray(steps, dtype=np.float64)
    lasted = np.broadcast_to(lasted.reshape(-1, 1) if lasted.ndim < 2 else lasted, found.shape)
    return found, np.where(np.isfinite(lasted), lasted, float(study.spec.horizon))


def weights_of(study: StepStudy, trainer: Trainer, policy: Policy) -> Any:
    """A policy as the trainer knows it: from this process, or read back.

    Raises:
        StorageError: it was in memory only, of a process that is gone.
    """
    key = study.key(policy)
    mark = study.state.trainings[key[0]].marks[key[1]]
    if key not in study.policies:
        if study.artifacts is None or mark.place is None:
            raise StorageError(
                f"the policy of training {key[0] + 1} was in memory only and is gone; run the "
                "study in one process, or give save and load functions"
            )
        study.policies[key] = trainer.load(study.artifacts.read(mark.place, mark.sha256))
    return study.policies[key]


def report_fresh(study: StepStudy, trainer: Trainer) -> None:
    """Record V on fresh episodes."""
    before = study.refresh().seq
    fresh = fresh_returns(study, trainer)
    data = {"error": fresh.error, "episodes": fresh.episodes, "steps": fresh.steps}
    with contextlib.suppress(Conflict):  # another process has gone on, or reported
        study.append("reported", data, {"returns": fresh.returns}, after=before)


def fresh_returns(study: StepStudy, trainer: Trainer) -> Fresh:
    """What the policies that serve return in fresh episodes, which chose nothing."""
    portfolio, state = study.portfolio(trainer), study.state
    route = portfolio.assignment
    each: dict[int, Array] = {}
    total = 0.0
    for i in np.unique(route).tolist():
        targets = np.flatnonzero(route == i)
        served = targets.tolist()
        found, steps = evaluated(study, trainer, state.policies[i], served, Purpose.REPORT)
        total += float(steps.sum())
        each |= dict(zip(served, found, strict=True))
    rows = np.array([each[t] for t in range(study.space.n)])
    by_episode = study.space.weights @ rows
    count = rows.shape[1]
    error = float(by_episode.std(ddof=1) / np.sqrt(count)) if count > 1 else None
    return Fresh(rows.mean(axis=1), error, count, total)
