"""Making and opening studies: settings are checked here, once, before anything is stored."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, overload

from numpy.typing import ArrayLike

from mbtl.actions import Strategy
from mbtl.contexts import Context, ContextSpace
from mbtl.errors import InvalidInput, StudyError, StudyMismatch, UnknownName
from mbtl.objective import Bounds, Direction, Objective, direction_named
from mbtl.plain import finite, real, short, text, whole
from mbtl.selectors import Selector
from mbtl.selectors.contract import traits_of
from mbtl.settings import described, first_difference
from mbtl.strategies import get_strategy, strategy_names
from mbtl.study.checks import check_spec
from mbtl.study.database import exists_already, shown
from mbtl.study.described import FROM, describe_selector, without_origin
from mbtl.study.events import Event
from mbtl.study.given import (
    any_given,
    check_axes,
    check_paid_in_steps,
    check_paid_in_trainings,
    check_wishes,
    costs_of,
    pair_of,
    target_count,
)
from mbtl.study.listing import chosen_name, database_at
from mbtl.study.places import fixed_url, policy_store
from mbtl.study.problem import Problem, ProblemFacts, check_problem, facts_of
from mbtl.study.spec import StudySpec
from mbtl.study.state import StudyState, replay
from mbtl.study.steps.create import create_step_study
from mbtl.study.steps.strategies import DEFAULT
from mbtl.study.steps.study import StepStudy
from mbtl.study.storage import Conflict, EventLog, MemoryLog, SqlLog
from mbtl.study.study import Study
from mbtl.study.wishes import Stopping, objective_of, stopping_of
from mbtl.trainer import Trainer
from mbtl.version import __version__


@overload
def create_study(
    space: ContextSpace | Problem,
    *,
    cost: Literal["steps"],
    budget: int | None = None,
    preset: str | None = None,
    trainer: Trainer | None = None,
    strategy: str | Strategy | None = None,
    lengths: Sequence[int] | None = None,
    episodes: int | None = None,
    horizon: int | None = None,
    bounds: tuple[float, float] | Bounds | None = None,
    direction: Direction | str | None = None,
    theta: float | None = None,
    seed: int = 0,
    trial: int = 0,
    storage: str | Path | None = None,
    artifacts: str | Path | None = None,
    name: str = "study",
    problem: str = "",
    settings: Mapping[str, Any] | None = None,
    load_if_exists: bool = False,
) -> StepStudy: ...


@overload
def create_study(
    space: ContextSpace | Problem,
    *,
    budget: int | None = None,
    preset: str | None = None,
    trainer: Trainer | None = None,
    selector: str | Selector = "auto",
    bounds: tuple[float, float] | Bounds | None = None,
    direction: Direction | str | None = None,
    objective: Objective | None = None,
    stopping: Stopping | None = None,
    theta: float | None = None,
    seed: int = 0,
    trial: int = 0,
    stop_value: float | None = None,
    cost_budget: float | None = None,
    costs: ArrayLike | Callable[[Context], float] | None = None,
    risk: float | None = None,
    eval_targets: int | None = None,
    stop_gain: float | None = None,
    stop_confidence: float | None = None,
    stop_left: float | None = None,
    best_return: float | None = None,
    storage: str | Path | None = None,
    artifacts: str | Path | None = None,
    name: str = "study",
    problem: str = "",
    settings: Mapping[str, Any] | None = None,
    load_if_exists: bool = False,
    cost: Literal["trainings"] = "trainings",
) -> Study: ...


def create_study(
    space: ContextSpace | Problem,
    *,
    budget: int | None = None,
    preset: str | None = None,
    trainer: Trainer | None = None,
    selector: str | Selector = "auto",
    bounds: tuple[float, float] | Bounds | None = None,
    direction: Direction | str | None = None,
    objective: Objective | None = None,
    stopping: Stopping | None = None,
    theta: float | None = None,
    seed: int = 0,
    trial: int = 0,
    stop_value: float | None = None,
    cost_budget: float | None = None,
    costs: ArrayLike | Callable[[Context], float] | None = None,
    risk: float | None = None,
    eval_targets: int | None = None,
    stop_gain: float | None = None,
    stop_confidence: float | None = None,
    stop_left: float | None = None,
    best_return: float | None = None,
    storage: str | Path | None = None,
    artifacts: str | Path | None = None,
    name: str = "study",
    problem: str = "",
    settings: Mapping[str, Any] | None = None,
    load_if_exists: bool = False,
    cost: Literal["trainings", "steps"] = "trainings",
    strategy: str | Strategy | None = None,
    lengths: Sequence[int] | None = None,
    episodes: int | None = None,
    horizon: int | None = None,
) -> Study | StepStudy:
    """Start a study.

    Args:
        space: the contexts, sources and targets alike; or a CMDP, which gives all that belongs to
            the problem and is not given here: contexts, budget, bounds, direction, theta, best
            return, id, trainer, and the record of its recipe.
        budget: number of trainings K, 1..N; of a strategy over trainings of every kind, units.
        preset: which recipe of the CMDP; None: its default.
        trainer: what `run` trains with when it is given nothing else; None: the CMDP's.
        selector: a registered name, "my_file.py:Mine", or an object with `propose`. "auto" heeds
            all that follows; of costs, risk and noise the paper's selectors know nothing.
        bounds: (low, high) of the returns, or `Bounds`, whose direction and floor then count; None
            takes the range told so far.
        direction: "maximize" (default) or "minimize" the returns; "max" and "min" will do.
        objective: bounds, direction, risk and best return in one record, instead of those keywords.
        stopping: when to end early in one record, instead of `stop_value`, `stop_gain`,
            `stop_left`, `stop_confidence` and `cost_budget`.
        theta: slope of the linear gap, performance per grid step; None: 0.005, or 0.5/(N-1) for
            N > 100.
        seed: root of the seed tree.
        trial: repetition; another trial has other training seeds.
        stop_value: end when V reaches this performance; needs bounds.
        cost_budget: end when the costs told add up to this; with `costs`, no source is proposed
            that costs more than what is left.
        costs: (N,) expected cost of a training on each context, or a function of the context. The
            selector then maximises gain per cost.
        risk: V is the mean over this share of the targets, those that do worst; None: 1, all.
        eval_targets: evaluate each policy on so many targets, its source among them
            (`Pick.targets`); None for all.
        stop_gain: end when one more training gains less than this in V ...
        stop_confidence: ... with at least this probability, as the selector predicts it after
            three rows or more; None: 0.9. V counts as what it surely is, with this probability.
        stop_left: end when nothing is left to gain: V is so near to what `best_return` is worth, or
            the selector predicts that all trainings left together gain less than this in V.
        best_return: the largest return there is (smallest, if minimised), if you know it.
        storage: path of an SQLite file or an SQLAlchemy URL; None keeps the study in memory.
        artifacts: folder that policies are saved below, or a URL that fsspec can write to, such as
            "s3://bucket/studies"; None: the folder of the database, where that is a file. Give it
            again to `load_study`.
        name: name of the study within its storage.
        problem: id of the problem, to refuse a study of another one.
        settings: JSON-able record of the recipe, to refuse a study of another; added to the CMDP's.
        load_if_exists: go on with a study of this name and settings. A larger budget raises that of
            the study, which goes on even if it was finished; a smaller one is refused.
        cost: what the budget counts: "trainings", or environment "steps", all in. The latter makes
            a `StepStudy`, which takes what follows, and no selector, objective, stopping rule,
            costs, risk or targets.
        strategy: decides what to train on, how long, and where to evaluate: a name or an object.
        lengths: see `mbtl.study.steps.create.create_step_study`, as for all that follows.
        episodes: of a policy on a target.
        horizon: most steps of an episode.

    Raises:
        InvalidInput: budget out of range, bounds reversed, unknown selector, ...
        StudyError: a study of this name exists and `load_if_exists` is False.
        StudyMismatch: it exists with other settings.
        StorageError: the storage cannot be written.
    """
    of_steps = {"strategy": strategy, "lengths": lengths, "episodes": episodes, "horizon": horizon}
    if cost == "steps":
        others = (objective, stopping, stop_value, cost_budget, costs, risk, eval_targets,
                  stop_gain, stop_confidence, stop_left, best_return)  # fmt: skip
        check_paid_in_steps(selector == "auto" and not any_given(others))
        return create_step_study(
            space, budget=budget, preset=preset, trainer=trainer, strategy=strategy or DEFAULT,
            lengths=lengths, episodes=episodes, horizon=horizon, bounds=bounds,
            direction=direction, theta=theta, seed=seed, trial=trial, storage=storage,
            artifacts=artifacts, name=name, problem=problem, settings=settings,
            load_if_exists=load_if_exists,
        )  # fmt: skip
    check_paid_in_trainings(cost, of_steps)
    chosen = get_strategy(selector)
    aim = objective_of(
        objective, bounds=bounds, direction=direction, risk=risk, best_return=best_return
    )
    end = stopping_of(
        stopping,
        stop_value=stop_value,
        stop_gain=stop_gain,
        stop_left=stop_left,
        stop_confidence=stop_confidence,
        cost_budget=cost_budget,
    )
    facts = facts_of(space, preset, trainer)
    space, trainer = facts.space, facts.trainer
    budget = facts.budget if budget is None else budget
    if budget is None:
        raise InvalidInput("a study of a ContextSpace needs budget=<number of trainings>; got none")
    budget, seed, trial = whole("budget", budget), whole("seed", seed), whole("trial", trial)
    direction = direction_named(facts.direction if aim.direction is None else aim.direction)
    bounds = facts.bounds if aim.bounds is None else aim.bounds
    floor = None
    if isinstance(bounds, Bounds):
        direction, floor = bounds.direction, bounds.floor
    pair = pair_of("bounds", bounds)
    if pair is not None:
        Bounds(*pair, direction, floor)
    stop_value = finite("stop_value", end.value)
    if stop_value is not None and bounds is None:
        raise InvalidInput("stop_value is a performance, so it needs bounds=(low, high); got none")
    if stop_value is not None and stop_value > 1.0:
        raise InvalidInput(
            f"stop_value is a performance, at most 1 (the better bound), got {stop_value!r}"
        )
    cost_budget = real("cost_budget", end.cost)
    stop_gain = real("stop_gain", end.gain)
    stop_left = real("stop_left", end.left)
    confidence = real("stop_confidence", end.confidence)
    if seed < 0 or trial < 0:
        raise InvalidInput(f"seed and trial must be >= 0, got {seed} and {trial}")
    check_wishes(chosen, stop_gain, confidence, bounds)
    if stop_left is not None and bounds is None:
        raise InvalidInput("stop_left is in performance, so it needs bounds=(low, high); got none")
    spec = StudySpec(
        space,
        budget,
        describe_selector(chosen, selector),
        pair,
        direction,
        finite("theta", facts.theta if theta is None else theta),
        seed,
        trial,
        stop_value,
        cost_budget,
        text("problem", facts.id if problem is None else problem) or facts.id,
        described({**facts.settings, **_record("settings", settings)}),
        costs_of(costs, space),
        real("risk", aim.risk),
        target_count(eval_targets, space.n),
        stop_gain,
        confidence,
        stop_left,
        finite("best_return", facts.best_return if aim.best_return is None else aim.best_return),
        floor,
        traits_of(chosen).any_training,
    )
    check_spec(spec)
    check_axes(chosen, spec.selection_problem())
    address = None if storage is None else fixed_url(storage)
    folder = policy_store(address, artifacts)
    log: EventLog = MemoryLog() if address is None else SqlLog(address, name, create=True)
    created = {"spec": spec.to_json(), "version": __version__, "uid": uuid.uuid4().hex[:8]}
    try:
        log.append(Event("created", created), after=0)
    except Conflict:
        study = Study(log, chosen, folder=folder, name=name, trainer=trainer)
        if not load_if_exists:
            raise exists_already(name, storage) from None
        _check_same(study.state, spec)
        if spec.budget > study.spec.budget:
            study.extend(spec.budget)
        return study
    return Study(log, chosen, folder=folder, name=name, trainer=trainer)


def _record(name: str, given: Any) -> Mapping[str, Any]:
    if given is not None and not isinstance(given, Mapping):
        raise InvalidInput(f"{name} must be a record, a dict of names, got {short(given)}")
    return given or {}


def load_study(
    storage: str | Path,
    name: str | None = None,
    *,
    problem: Problem | None = None,
    trainer: Trainer | None = None,
    selector: str | Selector | None = None,
    artifacts: str | Path | None = None,
) -> Study:
    """Open an existing study.

    Args:
        storage: path of the SQLite file (or of the folder that holds `study.db`), or a URL.
        name: name of the study; needed only when the storage holds several.
        problem: the CMDP that it is a study of; its recipe trains and reads the policies.
        trainer: what `run` trains with, and what reads the policies; None: the problem's.
        selector: as it was given to `create_study`; needed only for one of your own. A log is
            never followed to code: it may be a stranger's.
        artifacts: folder that policies are saved below, as it was given to `create_study`.

    Raises:
        StorageError: no database there, or a damaged one.
        StudyError: no such study, or several and no name.
        StudyMismatch: it is a study of another problem, or with another selector.
    """
    place = database_at(storage)
    name = chosen_name(place, name)
    log = SqlLog(place, name)
    events = log.read()
    if not events:
        raise StudyError(f"there is no study {name!r} in {shown(place)}")
    state = replay(events)
    spec = state.spec
    assert spec is not None
    if problem is not None:
        facts = _facts_then(problem, spec, trainer)
        check_problem(spec, facts)
        trainer = facts.trainer
    chosen = _selector_then(spec, selector)
    folder = policy_store(place, artifacts)
    return Study(log, chosen, folder=folder, name=name, trainer=trainer, state=state)


def _facts_then(problem: Problem, spec: StudySpec, trainer: Trainer | None) -> ProblemFacts:
    """The problem with the recipe of the study, where it still has that."""
    preset = spec.settings.get("preset")
    try:
        return problem.facts(preset if isinstance(preset, str) else None, trainer)
    except UnknownName:
        return problem.facts(None, trainer)


def _selector_then(spec: StudySpec, given: str | Selector | None) -> Selector:
    """The selector of the study: by its registered name, or as it is given."""
    stored = dict(spec.selector)
    name = str(stored["name"])
    if given is None and (FROM in stored or name not in strategy_names()):
        again = repr(stored[FROM]) if FROM in stored else "<the object>"
        raise StudyError(
            f"this study was made with a selector of your own, {name!r}; give it as "
            f"selector={again}"
        )
    chosen = get_strategy(name if given is None else given)
    if describe_selector(chosen) != without_origin(stored):
        raise StudyMismatch(
            f"this study was made with the selector {stored}, got {describe_selector(chosen)}; "
            "give the same one as selector="
        )
    return chosen


def _check_same(state: StudyState, given: StudySpec) -> None:
    """Refuse other settings; the budget may be larger, and settings that came later are free."""
    records, stored = [], state.spec
    assert stored is not None
    for spec in (stored, given):
        record = {**spec.to_json(), "selector": without_origin(spec.selector)}
        records.append({name: record[name] for name in state.settings_named})
    was, now = records
    was["budget"] = max(stored.budget, given.budget)  # less is refused, more extends the study
    difference = stored.space.difference(given.space) or first_difference(was, now)
    if difference:
        key, old, new = difference
        raise StudyMismatch(
            f"a stored study goes on only with the settings it was made with: {key} was {old!r}, "
            f"got {new!r}; repeat the old setting, or start afresh with --new (or another name)"
        )
