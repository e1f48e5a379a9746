"""One condition more: tune the policy that serves a target, and keep it if it is better there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context, ContextSpace, Value
from mbtl.episodes import episode_moments, margin_of_sum
from mbtl.errors import ContextMismatch, MbtlError, TrainingFailed
from mbtl.faults import FAULTS, reason_of
from mbtl.portfolio import Choice, Portfolio
from mbtl.problems.cmdp import CMDP
from mbtl.seeds import Purpose, evaluation_seeds, training_seed
from mbtl.trainers.contract import OnProgress, check_asked, checked_returns, completed


@dataclass(frozen=True, eq=False)
class Adapted:
    """A policy that was tuned for one target, beside the one that it began with.

    Attributes:
        target: the context.
        choice: who served it before, and why.
        policy: the tuned one.
        length: units that it was tuned for.
        before: (E,) returns there of the policy that served, on fresh episodes.
        after: (E,) of the tuned one, on the same episodes.
        lead: performance that tuning has brought, mean over the episodes.
        margin: half the 95 % interval of the lead; infinite where there is one episode.
    """

    target: Context
    choice: Choice
    policy: Any
    length: float
    before: Array
    after: Array
    lead: float
    margin: float

    @property
    def is_better(self) -> bool:
        """The lead is no luck."""
        return self.lead > self.margin

    @property
    def explanation(self) -> str:
        """The outcome in a sentence."""
        was, now = (float(returns.mean()) for returns in (self.before, self.after))
        more = "run again with more eval_episodes, or with an evaluate that returns more"
        few = f"Too few episodes to tell ({more})"
        verdict = few if abs(self.lead) <= self.margin else "It is worse"
        if (self.after == self.before).all():
            verdict = "It behaves the same there"
        verdict = "It is better" if self.is_better else verdict
        return (
            f"{verdict}: the tuned policy returned {now:.6g} there, policy "
            f"{self.choice.policy + 1} {was:.6g}, a lead of {self.lead:.4f} +- {self.margin:.4f} "
            "in performance."
        )


def adapt(
    portfolio: Portfolio,
    problem: CMDP,
    to: Mapping[str, Value],
    *,
    length: float = 1.0,
    seed: int = 0,
    on_progress: OnProgress | None = None,
) -> Adapted:
    """Tune the policy that serves a target for it, and compare both there.

    Args:
        portfolio: of the problem.
        problem: whose trainer goes on from a policy.
        to: the target, within the axes; it need not be one of the listed contexts.
        length: units of training: 1.0 is one whole training.
        seed: of the training and of the episodes.
        on_progress: told now and then.

    Raises:
        ContextMismatch: the target lies outside the axes.
        InvalidInput: the trainer cannot begin with a policy, or a length that is not above 0.
        TrainingFailed: the training or an evaluation fails.
    """
    trainer = problem.facts().trainer
    assert trainer is not None
    target = dict(to)
    choice = portfolio.explain(target)
    check_asked(trainer, [target], start=choice, length=length)
    begun = replace(portfolio, load=trainer.load).policy(choice.policy)
    here, listed = portfolio.space.encode_steps(target), portfolio.space.steps
    home = int(np.linalg.norm(listed - here, axis=1).argmin())  # the nearest in grid steps
    own = training_seed(seed, 0, home, lineage=(1, choice.policy))
    seeds = evaluation_seeds(seed, 0, [portfolio.space.n + home], Purpose.REPORT)
    try:
        trained = trainer.train([target], own, start=begun, length=length, on_progress=on_progress)
        before, after = (
            completed(checked_returns(trainer.evaluate(policy, [target], seeds), 1, [target]))[0]
            for policy in (begun, trained.policy)
        )
    except MbtlError:
        raise
    except FAULTS as error:
        raise TrainingFailed(
            f"a policy could not be tuned for {target}: {reason_of(error)}; mend the cause and run "
            "again, the portfolio is as it was"
        ) from error
    leads = portfolio.bounds.normalise(after) - portfolio.bounds.normalise(before)
    lead, margin = float(leads.mean()), margin_of_sum(leads[None, :])
    return Adapted(target, choice, trained.policy, length, before, after, lead, margin)


def with_adapted(
    portfolio: Portfolio,
    problem: CMDP,
    adapted: Adapted,
    folder: str | Path,
    *,
    seed: int = 0,
    say: Callable[[str], None] = lambda words: None,
) -> Portfolio:
    """Evaluate a tuned policy on all listed contexts and save the portfolio with it.

    A target that was not listed is from now on, without weight: V is of the others.

    Args:
        portfolio: to add it to.
        problem: of both.
        adapted: the policy.
        folder: to write; a portfolio there is replaced.
        seed: of the study's evaluations, so that rows are of the same episodes.
        say: told what is done.

    Raises:
        StorageError: the folder cannot be written, or a policy cannot be saved.
    """
    trainer, k = problem.facts().trainer, len(portfolio)
    assert trainer is not None
    space, padded = _with_target(portfolio, adapted)
    say(f"evaluating it on all {space.n} contexts")
    seeds = evaluation_seeds(seed, 0, range(space.n))
    returns = trainer.evaluate(adapted.policy, space.contexts, seeds)
    row = checked_returns(returns, space.n, space.contexts)
    note = {
        "to": adapted.target,
        "from": adapted.choice.policy,
        "length": adapted.length,
        "lead": adapted.lead,
    }
    with TemporaryDirectory() as place:
        saved = trainer.save(adapted.policy, Path(place))
        larger = replace(
            portfolio,
            space=space,
            sources=(*portfolio.sources, space.index(adapted.target)),
            returns=np.array([episode_moments(each)[0] for each in (*padded, row)]),
            episodes=(*padded, row) if portfolio.episodes else (),
            policy_folders=(*portfolio.policy_folders, Path(place) if saved else None),
            in_memory={**portfolio.in_memory, k: adapted.policy},
            metadata={
                **portfolio.metadata,
                "adapted": [*portfolio.metadata.get("adapted", []), {"policy": k, **note}],
            },
        )
        larger.save(folder, overwrite=True)
    return larger


def _with_target(portfolio: Portfolio, adapted: Adapted) -> tuple[ContextSpace, list[Array]]:
    """The listed contexts and the target, and what is known of each policy there, (N, E_i).

    A router that knew a policy at its neighbours alone would not see that it is best at its home.
    """
    space, weights = portfolio.space, portfolio.space.weights
    known = list(portfolio.episodes) or [row[:, None] for row in portfolio.returns]
    try:
        home = space.index(adapted.target)
    except ContextMismatch:
        home, every = space.n, [*space.contexts, adapted.target]
        space = ContextSpace.points(space.axes, every, weights=[*weights, 0.0])
        known = [np.vstack([each, np.full((1, each.shape[1]), np.nan)]) for each in known]
    served = known[adapted.choice.policy] = known[adapted.choice.policy].copy()
    if not np.isfinite(served[home]).any():
        some = adapted.before[: served.shape[1]]
        served[home, : len(some)] = some if portfolio.episodes else adapted.before.mean()
    return space, known
