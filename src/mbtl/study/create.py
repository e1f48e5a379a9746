"""Making and opening studies: settings are checked here, once, before anything is stored."""

from __future__ import annotations

import dataclasses
import uuid
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mbtl.contexts import Context, ContextSpace
from mbtl.errors import InvalidInput, StudyError, StudyMismatch, UnknownName
from mbtl.objective import Bounds, Objective, direction_named
from mbtl.plain import finite, float_of, floats, is_finite, real, record, short, whole
from mbtl.selectors import Selector
from mbtl.selectors.contract import traits_of
from mbtl.settings import described, first_difference
from mbtl.strategies import get_strategy, strategy_names
from mbtl.study.artifacts import policy_store
from mbtl.study.budget import Cost, Steps
from mbtl.study.database import database_file, fixed_url, shown
from mbtl.study.events import Event
from mbtl.study.listing import opened
from mbtl.study.problem import Beside, Problem, ProblemFacts, check_problem, facts_of
from mbtl.study.spec import StudySpec, check_spec
from mbtl.study.state import StudyState
from mbtl.study.storage import Conflict, EventLog, MemoryLog, SqlLog, names_in
from mbtl.study.study import Study
from mbtl.trainers.contract import Trainer
from mbtl.version import __version__

EPISODES = 10
"""Of a policy on a target, as expected before the first where the trainer does not say."""
NO_LIMIT = 10**6
"""Units of a study that its cost ends."""
FROM = "from"
"""Key of the text by which a user named a selector of their own."""


@dataclass(frozen=True)
class Evaluation:
    """Where policies are evaluated.

    Attributes:
        targets: each policy on so many contexts, two or more, those it was trained on among them
            (`Pick.targets`); None: on all.
    """

    targets: int | None = None


@dataclass(frozen=True)
class Stopping:
    """When a study ends before its budget is spent; None: never for that.

    Attributes:
        value: V, performance, that is enough; needs bounds.
        left: gain in V that all trainings left together should be worth, as the strategy predicts
            after three rows or more, or that is left to what `Objective.best_return` is worth;
            needs bounds.
        confidence: how probable that must be, and that V is what it seems, in (0, 1).
    """

    value: float | None = None
    left: float | None = None
    confidence: float = 0.9


def create_study(
    problem: ContextSpace | Problem,
    *,
    budget: int | Steps | Cost | None = None,
    strategy: str | Selector = "auto",
    objective: Objective | None = None,
    evaluation: Evaluation | None = None,
    stopping: Stopping | None = None,
    storage: str | Path | None = None,
    artifacts: str | Path | None = None,
    name: str | None = None,
    seed: int = 0,
    load_if_exists: bool = False,
) -> Study:
    """Start a study.

    Args:
        problem: a CMDP, which says what belongs to it: contexts, budget, bounds, direction, trainer
            and recipe (`CMDP.recipe` chooses another one); or a bare `ContextSpace`.
        budget: number of trainings; or `Steps` or a `Cost`; None: the problem's, or that of a
            study that goes on, where it is larger, or no number.
        strategy: what to train next: a name such as "auto", "mbtl", "all-first"; "my_file.py:Mine";
            or an object with `propose`.
        objective: what V is; None: as the problem has it.
        evaluation: where policies are evaluated; None: on all contexts.
        stopping: when to end early; None: when the budget is spent.
        storage: path of an SQLite file or an SQLAlchemy URL; None keeps the study in memory.
        artifacts: folder that policies are saved below, or a URL that fsspec can write to, such as
            "s3://bucket/studies"; None: the folder of the database, where that is a file. Give it
            again to `load_study`.
        name: name of the study within its storage; None: "study", or with `load_if_exists` that of
            the only one in a file, as `mbtl run` makes one.
        seed: root of the seed tree.
        load_if_exists: go on with a study of this name and settings. A larger budget raises that of
            the study, which goes on even if it was finished; so it does with another `value` of
            `stopping`, or with no `stopping` where there was one. A smaller budget is refused.

    Raises:
        InvalidInput: budget out of range, bounds reversed, unknown strategy, ...
        StudyError: a study of this name exists and `load_if_exists` is False.
        StudyMismatch: it exists with other settings.
        StorageError: the storage cannot be written.
    """
    chosen, facts = get_strategy(strategy), facts_of(problem)
    spec = _spec(
        facts,
        chosen,
        describe_selector(chosen, strategy),
        _budget(budget, facts.budget),
        record("objective", objective, Objective(), Objective),
        record("evaluation", evaluation, Evaluation(), Evaluation),
        record("stopping", stopping, Stopping(), Stopping),
        whole("seed", seed),
    )
    check_spec(spec)
    if spec.eval_targets == 1 < spec.space.n:  # older studies may have it, and go on
        raise InvalidInput(
            f"policies are evaluated on 2 to {spec.space.n} targets, got 1; a policy at home says "
            "nothing of elsewhere"
        )
    if traits_of(chosen).one_axis:
        _ = spec.selection_problem().line  # refuses several
    address = None if storage is None else fixed_url(storage)
    folder = policy_store(address, artifacts)
    name = _usual_name(address if load_if_exists else None) if name is None else name
    log: EventLog = MemoryLog() if address is None else SqlLog(address, name, create=True)
    created = {"spec": spec.to_json(), "version": __version__, "uid": uuid.uuid4().hex[:8]}
    known: dict[str, Any] = {"trainer": facts.trainer, "beside": facts.beside}
    try:
        log.append(Event("created", created), after=0)
    except Conflict:
        study = Study(log, chosen, folder=folder, name=name, **known)
        if not load_if_exists:
            raise StudyError(
                f"a study named {name!r} exists in {shown(str(storage))}; pass load_if_exists=True "
                "to go on with it, or choose another name"
            ) from None
        if budget is None:
            spec = _as_large(spec, study.spec)
        _check_same(study.state, spec, name)
        if _sizes(spec) > _sizes(study.spec):
            total = Cost(spec.cost_budget, None, spec.budget) if spec.cost_budget else spec.budget
            study.extend(total if spec.steps is None else Steps(spec.steps))
        if _ends(spec) != _ends(study.spec):
            study.end_as(spec)
        return study
    return Study(log, chosen, folder=folder, name=name, **known)


def _as_large(spec: StudySpec, stored: StudySpec) -> StudySpec:
    """With the budget of the stored study, which may be raised; of two numbers the larger."""
    if stored.in_units:
        return replace(spec, budget=max(spec.budget, stored.budget))
    names = ("budget", "steps", "unit", "horizon", "target_steps", "cost_budget", "costs")
    return replace(spec, **{name: getattr(stored, name) for name in names})


def _sizes(spec: StudySpec) -> tuple[float, ...]:
    """Steps, cost and trainings: what a larger budget has more of."""
    return spec.steps or 0, spec.cost_budget or 0.0, spec.budget


def _ends(spec: StudySpec) -> tuple[float | None, ...]:
    """What ends it before its budget does."""
    return spec.stop_left, spec.stop_value


def _budget(given: Any, usual: Any) -> Any:
    """A number, which is checked as such, or a record of another budget."""
    if given is not None and not hasattr(given, "__dict__"):
        return given
    return record("budget", given, usual, Steps, Cost)


def _usual_name(address: str | None) -> str:
    """Of a study that has none: that of the only one in a file, so that it is found again."""
    file = None if address is None else database_file(address)
    names = [] if file is None else names_in(file)
    return names[0] if len(names) == 1 else "study"


def _spec(
    facts: ProblemFacts,
    strategy: Selector,
    described_strategy: dict[str, Any],
    budget: int | Steps | Cost | None,
    aim: Objective,
    evaluation: Evaluation,
    end: Stopping,
    seed: int,
) -> StudySpec:
    """The settings of a study, made plain."""
    space, any_training = facts.space, traits_of(strategy).any_training
    cost = budget if isinstance(budget, Cost) else None
    counted = _in_steps(facts, budget) if isinstance(budget, Steps) else {}
    if isinstance(budget, Steps):
        budget = max(1, budget.total // counted["unit"])
        budget = budget if any_training else min(budget, space.n)
    elif cost is not None:
        budget = cost.trainings or (NO_LIMIT if any_training else facts.budget or space.n)
    if budget is None:
        raise InvalidInput("a study of a ContextSpace needs budget=<number of trainings>; got none")
    direction = direction_named(facts.direction if aim.direction is None else aim.direction)
    bounds, floor = facts.bounds if aim.bounds is None else aim.bounds, None
    if isinstance(bounds, Bounds):
        direction, floor = bounds.direction, bounds.floor
    pair = _pair_of("bounds", bounds)
    best = facts.best_return if aim.best_return is None else aim.best_return
    best = finite("best_return", best)
    limits = None if pair is None else Bounds(*pair, direction, floor)
    if limits is not None and best is not None and limits.normalise(best) <= 0.0:
        raise InvalidInput(
            f"best_return must be better than the return that counts as 0, got {best:g} with "
            f"bounds {pair}; correct one of them"
        )
    _check_stopping(end, pair)
    costs = _costs_of(None if cost is None else cost.per_context, space)
    if cost is not None and costs is not None and cost.total < min(costs):
        raise InvalidInput(
            f"a cost budget pays for one training at least, and the cheapest costs {min(costs):g}, "
            f"got {cost.total:g}"
        )
    if seed < 0:
        raise InvalidInput(f"a seed is a whole number >= 0, got {seed}")
    targets = evaluation.targets
    return StudySpec(
        space,
        whole("budget", budget),
        described_strategy,
        pair,
        direction,
        finite("theta", facts.theta),
        seed,
        facts.trial,
        finite("value of Stopping", end.value),
        None if cost is None else float(cost.total),
        facts.id,
        described(dict(facts.settings)),
        costs,
        real("risk", aim.risk),
        None if targets is None else whole("targets of Evaluation", targets),
        real("confidence of Stopping", end.confidence),
        real("left of Stopping", end.left),
        best,
        floor,
        any_training,
        **counted,
    )


def _in_steps(facts: ProblemFacts, budget: Steps) -> dict[str, int]:
    """Environment steps of the budget, a unit, an episode, and an evaluation on one target."""
    trainer = facts.trainer
    horizon = facts.horizon if budget.horizon is None else budget.horizon
    unit = budget.unit
    if unit is None and trainer is not None and trainer.whole is not None:
        unit = trainer.whole * (1 if trainer.counts == "steps" else horizon or 1)
    if unit is None or horizon is None:
        known = {"unit": unit, "horizon": horizon}
        missing = ", ".join(f"{name}=<steps>" for name, steps in known.items() if steps is None)
        raise InvalidInput(
            "to pay in environment steps it must be known how many a whole training (unit) and the "
            f"longest episode (horizon) have; give Steps({budget.total}, {missing}) in Python, for "
            "`mbtl run --steps` goes by the problem alone: by its horizon=<steps>, and by `whole` "
            "of its trainer, which functions do not have"
        )
    episodes = int(getattr(trainer, "eval_episodes", None) or EPISODES)
    each = {"horizon": horizon, "target_steps": horizon * episodes}
    return {"steps": budget.total, "unit": unit, **each}


def load_study(
    storage: str | Path,
    name: str | None = None,
    *,
    problem: Problem | None = None,
    trainer: Trainer | None = None,
    strategy: str | Selector | None = None,
    artifacts: str | Path | None = None,
) -> Study:
    """Open an existing study.

    Args:
        storage: path of the SQLite file (or of the folder that holds `study.db`), or a URL.
        name: name of the study; needed only when the storage holds several.
        problem: the CMDP that it is a study of; its recipe trains and reads the policies.
        trainer: what `run` trains with, and what reads the policies; None: the problem's.
        strategy: as it was given to `create_study`; needed only for one of your own. A log is
            never followed to code: it may be a stranger's.
        artifacts: folder that policies are saved below, as it was given to `create_study`.

    Raises:
        StorageError: no database there, or a damaged one.
        StudyError: there is no study.
        InvalidInput: there are several and no name is given, or none has that name.
        StudyMismatch: it is a study of another problem, or with another strategy.
    """
    log, state = opened(storage, name)
    spec, beside = state.spec, Beside()
    if problem is not None:
        facts = _facts_then(problem, spec, trainer)
        check_problem(spec, facts)
        trainer, beside = facts.trainer, facts.beside
    chosen = _strategy_then(spec, strategy)
    folder, name = policy_store(log.url, artifacts), log.study
    return Study(log, chosen, folder=folder, name=name, trainer=trainer, beside=beside, state=state)


def _facts_then(problem: Problem, spec: StudySpec, trainer: Trainer | None) -> ProblemFacts:
    """The problem with the recipe of the study, where it still has that."""
    preset = spec.settings.get("preset")
    try:
        return problem.facts(preset if isinstance(preset, str) else None, trainer)
    except UnknownName:
        return problem.facts(None, trainer)


def _strategy_then(spec: StudySpec, given: str | Selector | None) -> Selector:
    """The strategy of the study: by its registered name, or as it is given."""
    stored = dict(spec.selector)
    name = str(stored["name"])
    if given is None and (FROM in stored or name not in strategy_names()):
        again = repr(stored[FROM]) if FROM in stored else "<the object>"
        raise StudyError(
            f"this study was made with a strategy of your own, {name!r}; give it as "
            f"strategy={again}"
        )
    chosen = get_strategy(name if given is None else given)
    if describe_selector(chosen) != without_origin(stored):
        raise StudyMismatch(
            f"this study was made with the strategy {stored}, got {describe_selector(chosen)}; "
            "give the same one as strategy="
        )
    return chosen


def _check_same(state: StudyState, given: StudySpec, name: str) -> None:
    """Refuse other settings; what extends the study is none: a larger budget, another end."""
    stored, now = state.spec, given
    if given.stop_left is None:
        now = replace(now, stop_left=stored.stop_left, stop_value=stored.stop_value)
    elif given.stop_value is not None:
        now = replace(now, stop_value=stored.stop_value)
    for size in ("budget", "steps", "cost_budget"):
        if (getattr(given, size) or 0) >= ((before := getattr(stored, size)) or 0):
            now = replace(now, **{size: before})
    was, now_record = (
        {
            **spec.to_json(),
            "selector": without_origin(spec.selector),
            "costs": dict(enumerate(spec.costs or ())),  # names the one that differs
        }
        for spec in (stored, now)
    )
    difference = stored.space.difference(given.space) or first_difference(was, now_record)
    if difference:
        key, *values = difference
        usual = key.startswith("selector.")  # settings that are the default are not stored
        old, new = ("the default" if usual and v is None else short(v) for v in values)
        how = (
            " (`mbtl run --all` asks for no end before the budget)"
            if key in ("stop_left", "stop_value")
            else ""
        )
        raise StudyMismatch(
            f"a stored study ({name!r}) goes on only with the settings it was made with: {key} was "
            f"{old}, got {new}{how}; repeat the old setting, or begin anew with --new (or "
            "another name)"
        )


# ---- a strategy, as a log says it ----------------------------------------------------------------


def describe_selector(selector: Selector, named: str | Selector | None = None) -> dict[str, Any]:
    """Name and settings of a selector, JSON-able and the same in every process.

    Args:
        selector: the object.
        named: what the user gave; a text such as "my.py:Mine" is kept, so that people find it.
    """

    def plain(value: Any) -> Any:
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            held = {f: getattr(value, f.name) for f in dataclasses.fields(value)}
            return {f.name: plain(given) for f, given in held.items() if given != _default(f)}
        if isinstance(value, (list, tuple)):
            return [plain(item) for item in value]
        return described(value)

    is_record = dataclasses.is_dataclass(selector)
    settings = plain(selector) if is_record else {"class": type(selector).__qualname__}
    own = {FROM: named} if isinstance(named, str) and ":" in named else {}
    return {**settings, **own, "name": selector.name}


def without_origin(description: Mapping[str, Any]) -> dict[str, Any]:
    """What two descriptions of one selector share, wherever it was found."""
    return {key: value for key, value in description.items() if key != FROM}


def _default(field: dataclasses.Field[Any]) -> Any:
    """What a field has where nothing is given; equal to nothing where it must be.

    Only changes are stored, so a selector may gain a setting and old studies still open.
    """
    made = field.default_factory
    return field.default if made is dataclasses.MISSING else made()


# ---- settings as they were given: made plain, or refused with the rule that they break ---------


def _costs_of(
    costs: ArrayLike | Callable[[Context], float] | None, space: ContextSpace
) -> tuple[float, ...] | None:
    """(N,) numbers, or None."""
    if costs is None:
        return None
    given = [costs(context) for context in space.contexts] if callable(costs) else costs
    try:
        array = floats(given)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInput(f"costs must be numbers, one per context ({error})") from error
    if array.shape != (space.n,):
        raise InvalidInput(f"costs must be {space.n} numbers, one per context, got {array.shape}")
    for i in np.flatnonzero(~np.isfinite(array)):
        raise InvalidInput(
            f"the cost of a training (per_context of Cost) is a finite number, got {array[i]:g} "
            f"for {space.describe(space.context(int(i)))}; give what one costs there"
        )
    return tuple(array.tolist())


def _check_stopping(end: Stopping, bounds: object) -> None:
    """What is said in performance needs bounds."""
    for name in ("value", "left"):
        value = getattr(end, name)
        if value is not None and bounds is None:
            raise InvalidInput(
                f"{name} of Stopping is in performance, so it needs bounds=(low, high); got none"
            )
    if end.value is not None and is_finite(end.value) and end.value > 1.0:
        raise InvalidInput(
            f"value of Stopping is a performance, at most 1 (the better bound), got {end.value!r}"
        )
    if not (is_finite(end.confidence) and 0.0 < end.confidence < 1.0):
        raise InvalidInput(
            f"confidence of Stopping is a probability in (0, 1), got {short(end.confidence)}"
        )


def _pair_of(name: str, pair: Iterable[float] | None) -> tuple[float, float] | None:
    """Two numbers, or None."""
    if pair is None:
        return None
    try:
        low, high = map(float_of, pair)
    except (TypeError, ValueError):
        low = high = None
    if low is None or high is None:
        raise InvalidInput(f"{name} must be two numbers (low, high), got {short(pair)}")
    return low, high
