"""What a study takes from a problem: a CMDP, or anything else that can say the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, cast, runtime_checkable

from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, StudyMismatch
from mbtl.objective import Bounds, Direction
from mbtl.plain import short
from mbtl.settings import first_difference
from mbtl.study.spec import StudySpec
from mbtl.trainers.contract import Trainer


@dataclass(frozen=True)
class Beside:
    """What people see beside V, of the same episodes.

    Attributes:
        metrics: unit by name of a measure.
        baselines: what V is compared with, by name (`mbtl.CMDP.baselines`).
    """

    metrics: Mapping[str, str] = field(default_factory=dict)
    baselines: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ProblemFacts:
    """Settings of a study that belong to its problem.

    Attributes:
        space: the contexts.
        budget: trainings K; None: not said.
        bounds: normalisation of the returns; None: the range told so far.
        direction: "maximize" or "minimize".
        theta: slope of the linear gap; None: the default.
        best_return: the largest return there is (smallest, if minimised); None: not known.
        id: short name; empty for none.
        settings: JSON-able record of version, switches and recipe.
        trainer: trains where no other is given; None: there is none.
        horizon: longest episode in environment steps; None: not known.
        trial: which repetition of the same problem this is.
        beside: what stands beside V.
    """

    space: ContextSpace
    budget: int | None = None
    bounds: Bounds | None = None
    direction: Direction = "maximize"
    theta: float | None = None
    best_return: float | None = None
    id: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    trainer: Trainer | None = None
    horizon: int | None = None
    trial: int = 0
    beside: Beside = field(default_factory=Beside)


@runtime_checkable
class Problem(Protocol):
    """A problem that knows how it is studied, such as `mbtl.CMDP`."""

    def facts(self, preset: str | None = None, trainer: Trainer | None = None) -> ProblemFacts:
        """Its facts; on request with the recipe `preset`, or with a trainer that differs."""
        ...


def facts_of(problem: ContextSpace | Problem) -> ProblemFacts:
    """The facts of a problem; of bare contexts there are few.

    Raises:
        InvalidInput: it is neither.
    """
    if isinstance(problem, ContextSpace):
        return ProblemFacts(problem)
    if isinstance(problem, Problem):
        return problem.facts()
    raise InvalidInput(
        f"the problem must be a ContextSpace or a CMDP, got {type(problem).__name__}; build one "
        "with ContextSpace.grid, ContextSpace.points, CMDP.from_functions or CMDP.from_env"
    )


def trainer_of(given: Trainer | Problem) -> Trainer:
    """A trainer; in its place a problem may be given, of which it is the recipe's.

    Raises:
        InvalidInput: it is neither.
    """
    found = given.facts().trainer if isinstance(given, Problem) else given
    if not hasattr(found, "policy_format"):
        raise InvalidInput(f"policies are made by a trainer, got {short(given)}; give the CMDP's")
    return cast(Trainer, found)


def check_problem(spec: StudySpec, facts: ProblemFacts) -> None:
    """Refuse a problem that a stored study is not of; recipes are compared when it is run.

    Raises:
        StudyMismatch: another space, id, version or switch.
    """
    names = [name for name in ("version", "switches") if name in spec.settings]
    stored = {"problem": spec.problem, **{name: spec.settings[name] for name in names}}
    given = {"problem": facts.id, **{name: facts.settings.get(name) for name in names}}
    difference = spec.space.difference(facts.space) or first_difference(stored, given)
    if difference is not None:
        name, was, now = difference
        raise StudyMismatch(
            f"a study is opened with the problem it was made for: {name} was {short(was)}, got "
            f"{short(now)}; give that problem, or leave it out"
        )
