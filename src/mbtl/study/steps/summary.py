"""A study that is paid in steps in numbers: trainings, price list, V."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mbtl.actions import Extend, Policy
from mbtl.contexts import Context
from mbtl.contexts.words import describe_set
from mbtl.notebook import table
from mbtl.portfolio import Portfolio

if TYPE_CHECKING:
    from mbtl.study.steps.study import StepStudy

Condition = Literal["running", "paused", "whole", "ended", "halted", "stopped", "failed"]


@dataclass(frozen=True)
class StepTraining:
    """One training of a study.

    Attributes:
        number: 0-based.
        source: context index.
        context: trained on; of several, the one in their middle.
        steps: done so far.
        state: "running"; "paused", it may go on; "whole", it has the whole length; "ended", nothing
            left to gain; "halted", no steps are left for it; "stopped", the study is over;
            "failed".
        why: that, in words.
        policies: of it that were evaluated.
        serves: contexts that they serve now.
        trained_on: the context in words, or "all contexts"; and of a warm start, from what.
    """

    number: int
    source: int
    context: Context
    steps: int
    state: Condition
    why: str
    policies: int
    serves: int
    trained_on: str = ""


@dataclass(frozen=True)
class StepSummary:
    """A study in numbers.

    Attributes:
        problem: id of the CMDP.
        strategy: its name.
        budget: environment steps.
        spent: of them.
        prices: environment steps by what they were paid for.
        lengths: environment steps at the marks of a training.
        episodes: of a policy on a target.
        finished: why nothing more is done; None while something is.
        verdict: what the strategy has found out, in a sentence; None: nothing.
        trainings: in the order of their starts.
        policies: evaluated somewhere.
        value: V by the rows that route; None before the first one.
        fresh_value: V on fresh episodes; None: not measured.
        fresh_margin: half its 95 % interval; None: unknown.
        fresh_steps: environment steps of those episodes, which are not charged.
    """

    problem: str
    strategy: str
    budget: int
    spent: float
    prices: dict[str, float]
    lengths: tuple[int, ...]
    episodes: int
    finished: str | None
    trainings: tuple[StepTraining, ...]
    policies: int
    value: float | None
    fresh_value: float | None
    fresh_margin: float | None
    fresh_steps: float | None
    verdict: str | None = None

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return asdict(self)

    def html(self) -> str:
        """For notebooks."""
        heads = ("training", "context", "steps", "state", "serves", "")
        lines = [
            (t.number + 1, t.trained_on, f"{t.steps:,}", t.state, t.serves, t.why)
            for t in self.trainings
        ]
        title = f"{counted(self.spent)} of {counted(self.budget)} steps"
        return table(
            title if self.value is None else f"{title}, V = {self.value:.4f}", heads, lines
        )


@dataclass(frozen=True, eq=False, repr=False)
class StepResult:
    """A study when a run of it has ended.

    Attributes:
        study: that was run.
        summary: its numbers.
        seconds: wall time of this run.
    """

    study: StepStudy
    summary: StepSummary
    seconds: float

    @property
    def value(self) -> float:
        """V at the end: on fresh episodes where they were played, else by the routing rows."""
        fresh, seen = self.summary.fresh_value, self.summary.value
        return fresh if fresh is not None else seen if seen is not None else float("-inf")

    def portfolio(self) -> Portfolio:
        """All policies that were evaluated, with their router."""
        return self.study.portfolio()

    def __repr__(self) -> str:
        s = self.summary
        where = "on fresh episodes" if s.fresh_value is not None else "on selecting episodes"
        return (
            f"StepResult({self.study.name!r}: {s.spent:,.0f} of {s.budget:,} steps, "
            f"{len(s.trainings)} trainings, {s.policies} policies, V = {self.value:.4f} {where}; "
            f"{s.finished})"
        )


def summarise(study: StepStudy) -> StepSummary:
    """The numbers of a study now."""
    state, spec = study.refresh(), study.spec
    fresh, fresh_value, margin = state.fresh, None, None
    serves = np.zeros(len(state.trainings), dtype=int)
    if state.policies:
        for i in study.portfolio().assignment.tolist():
            serves[state.policies[i].training] += 1
    if fresh is not None:
        bounds = study.bounds
        fresh_value = float(bounds.normalise(fresh.returns) @ study.space.weights)
        if fresh.error is not None:
            from scipy.special import stdtrit  # kept out of `import mbtl`

            width = abs(bounds.high - bounds.low)
            margin = float(stdtrit(fresh.episodes - 1, 0.975) * fresh.error / width)
    return StepSummary(
        spec.problem,
        str(spec.strategy["name"]),
        spec.budget,
        state.spent,
        asdict(state.prices),
        spec.lengths,
        spec.episodes,
        state.stopped,
        tuple(_training(study, j, int(serves[j])) for j in range(len(state.trainings))),
        len(state.policies),
        study.value if state.policies else None,
        fresh_value,
        margin,
        None if fresh is None else fresh.steps,
        verdict_of(study),
    )


def _training(study: StepStudy, number: int, serves: int) -> StepTraining:
    course = study.state.trainings[number]
    state, why = condition(study, number)
    return StepTraining(
        number,
        course.source,
        study.space.context(course.source),
        course.steps,
        state,
        why,
        sum(policy.training == number for policy in study.state.policies),
        serves,
        where_of(study, number),
    )


def condition(study: StepStudy, number: int) -> tuple[Condition, str]:
    """How a training stands, and why."""
    course, state = study.state.trainings[number], study.state
    work, lengths = state.work_on(number), state.lengths_of(number)
    if course.failed is not None:
        return "failed", course.failed
    if work is not None:
        towards = "going on" if isinstance(work, Extend) else "on its way"
        return "running", f"{towards} to {counted(lengths[work.length])} steps"
    if course.ended:
        return "ended", "its own context gives the largest return there is"
    if course.length == len(lengths) - 1 and not course.on:
        return "whole", "the whole length"
    if course.halted:
        return "halted", "no steps are left for more"
    if state.stopped is not None:
        return "stopped", "the study is over"
    return "paused", "may go on, if that promises more than other trainings"


def training_words(study: StepStudy, number: int) -> str:
    """A training in one line."""
    course = study.state.trainings[number]
    state, why = condition(study, number)
    where = where_of(study, number)
    return f"training {number + 1} ({where}): {counted(course.steps)} steps, {state}: {why}"


def verdict_of(study: StepStudy) -> str | None:
    """What the strategy has found out, in a sentence; None: it says nothing."""
    says = getattr(study.strategy, "verdict", None)
    if says is None:
        return None
    problem = study.spec.problem_without(tuple(study.state.dead))
    return None if (found := says(problem, study.trail)) is None else str(found)


def where_of(study: StepStudy, number: int) -> str:
    """What a training is trained on, in words."""
    course = study.state.trainings[number]
    where = describe_set(study.space, course.on or (course.source,))
    if course.start is None:
        return where
    return f"{where}, {begun_from(study, course.start)}"


def begun_from(study: StepStudy, policy: Policy) -> str:
    """Whose weights a training began with, in words."""
    _, mark = study.state.trainings[policy.training].at(policy.length)
    return f"from training {policy.training + 1} at {counted(mark.steps)}"


def counted(steps: float) -> str:
    """Steps as people say them, e.g. "1.25M"."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "K")):
        if steps >= size:
            return f"{steps / size:.3g}{letter}"
    return f"{steps:.0f}"
