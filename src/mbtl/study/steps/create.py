"""Opening a study that is paid in steps: settings are checked here, before anything is stored."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from mbtl.actions import Strategy
from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, StudyMismatch
from mbtl.objective import Bounds, direction_named
from mbtl.plain import finite, text, whole
from mbtl.settings import described, first_difference
from mbtl.study.database import exists_already, shown
from mbtl.study.described import describe_selector, without_origin
from mbtl.study.events import OPENED, Event
from mbtl.study.given import pair_of
from mbtl.study.places import fixed_url, policy_store
from mbtl.study.problem import Problem, facts_of
from mbtl.study.steps.kept import check_artifacts, marked
from mbtl.study.steps.prices import whole_length
from mbtl.study.steps.spec import StepSpec
from mbtl.study.steps.strategies import DEFAULT, strategy_named
from mbtl.study.steps.study import StepStudy
from mbtl.study.storage import Conflict, EventLog, MemoryLog, SqlLog
from mbtl.trainer import Trainer
from mbtl.version import __version__

EPISODES = 10
"""Of a policy on a target, as in the shipped transfer curves."""
SHORTEST = 8_000
"""Environment steps that the first length has at least, where a whole training has more."""


def lengths_of(whole_steps: int) -> tuple[int, ...]:
    """Marks of a training: its whole length, the half, the quarter, ..., down to `SHORTEST`."""
    halvings = 0
    while whole_steps / 2 ** (halvings + 1) >= SHORTEST:
        halvings += 1
    return tuple(-(-whole_steps // 2**h) for h in range(halvings, -1, -1))


def create_step_study(
    space: ContextSpace | Problem,
    *,
    budget: int | None = None,
    preset: str | None = None,
    trainer: Trainer | None = None,
    strategy: str | Strategy = DEFAULT,
    lengths: Sequence[int] | None = None,
    episodes: int | None = None,
    horizon: int | None = None,
    bounds: tuple[float, float] | Bounds | None = None,
    direction: str | None = None,
    theta: float | None = None,
    seed: int = 0,
    trial: int = 0,
    storage: str | Path | None = None,
    artifacts: str | Path | None = None,
    name: str = "study",
    problem: str = "",
    settings: Mapping[str, Any] | None = None,
    load_if_exists: bool = False,
) -> StepStudy:
    """Start a study that is paid in environment steps, all in.

    Args:
        space: the contexts, or a CMDP.
        budget: environment steps of trainings, extensions and evaluations together.
        preset: which recipe of the CMDP; None: its default. Its training is the longest one.
        trainer: what `run` trains with; None: the CMDP's.
        strategy: "pilot", "fixed", "halving", "asha", "committee", or an
            object with `name` and `decide`.
        lengths: environment steps at which a training may pause, rising; None: the whole length of
            the trainer's and its halves down to 8,000. Plain functions need it: one length for
            `train(context, seed)`, any for one that takes `length`. Where a recipe counts episodes
            these are steps of so many of the longest ones, and what was played is charged.
        episodes: of a policy on a target; None: 10.
        horizon: most steps of an episode; None: the CMDP's.
        bounds: (low, high) of the returns, or `Bounds`; None: the CMDP's, else the range so far.
        direction: "maximize" (default) or "minimize".
        theta: slope of the linear gap, performance per grid step; None: the default.
        seed: root of the seed tree.
        trial: repetition; another trial has other training seeds.
        storage: path of an SQLite file or an SQLAlchemy URL; None keeps the study in memory.
        artifacts: folder or URL of the policies; None: beside the database's file.
        name: name of the study within its storage.
        problem: id of the problem, to refuse a study of another one.
        settings: JSON-able record of the recipe, to refuse a study of another one.
        load_if_exists: go on with an existing study of the same settings; a larger budget extends
            it.

    Raises:
        InvalidInput: a setting that means nothing, or a budget below one evaluation.
        UnknownName: no such strategy.
        StudyError: a study of this name exists and `load_if_exists` is False.
        StudyMismatch: it exists with other settings.
    """
    chosen, facts = strategy_named(strategy), facts_of(space, preset, trainer)
    if budget is None:
        raise InvalidInput("a study that is paid in steps needs budget=<environment steps>")
    longest = horizon if horizon is not None else facts.horizon
    if longest is None:
        raise InvalidInput(
            "episodes are paid in steps, so it must be known how long one is at most; give "
            "horizon=<steps>"
        )
    aim = facts.bounds if bounds is None else bounds
    way = direction_named(facts.direction if direction is None else direction)
    floor = None
    if isinstance(aim, Bounds):
        way, floor = aim.direction, aim.floor
    spec = StepSpec(
        facts.space,
        whole("budget", budget),
        describe_selector(chosen),  # type: ignore[arg-type]  # any record with a name
        _lengths(lengths, facts.trainer, whole("horizon", longest)),
        EPISODES if episodes is None else whole("episodes", episodes),
        whole("horizon", longest),
        pair_of("bounds", aim),
        way,
        floor,
        finite("theta", facts.theta if theta is None else theta),
        whole("seed", seed),
        whole("trial", trial),
        text("problem", problem) or facts.id,
        described({**facts.settings, **(settings or {})}),
    )
    address = None if storage is None else fixed_url(storage)
    store = policy_store(address, artifacts)
    log: EventLog = MemoryLog() if address is None else SqlLog(address, name, create=True)
    given: dict[str, Any] = {"store": store, "name": name, "trainer": facts.trainer}
    if next(iter(log.read()), None) is not None:
        return _existing(log, spec, chosen, storage, load_if_exists, **given)
    uid = uuid.uuid4().hex[:8]
    opened = {"spec": spec.to_json(), "version": __version__, "uid": uid}
    if store is not None and address is not None:
        opened["kept"] = marked(store, uid)
    try:
        log.append(Event(OPENED, opened), after=0)
    except Conflict:  # another process made it at the same moment
        return _existing(log, spec, chosen, storage, load_if_exists, **given)
    return StepStudy(log, chosen, **given)


def _lengths(given: Sequence[int] | None, trainer: Trainer | None, horizon: int) -> tuple[int, ...]:
    if given is not None:
        found = tuple(whole("a length", length) for length in given)
        if not found or found[0] < 1 or any(a >= b for a, b in pairwise(found)):
            raise InvalidInput(f"lengths are numbers of steps >= 1 that rise, got {list(given)}")
        return found
    total = None if trainer is None else whole_length(trainer, horizon)
    if total is None:
        what = "no trainer" if trainer is None else type(trainer).__name__
        raise InvalidInput(
            f"how long a training is must be known to pay for it, and {what} does not say; give "
            "lengths=[<steps>], one for a train function of fixed length"
        )
    return lengths_of(total)


def _existing(
    log: EventLog,
    spec: StepSpec,
    strategy: Strategy,
    storage: str | Path | None,
    wanted: bool,
    **given: Any,
) -> StepStudy:
    if next(iter(log.read())).kind != OPENED:
        raise StudyMismatch(
            f"the study {given['name']!r} in {shown(str(storage))} is paid in trainings; start "
            "another one (--new, or another name)"
        )
    study = StepStudy(log, strategy, **given)
    if not wanted:
        raise exists_already(given["name"], storage)
    was, now = study.spec.to_json(), spec.to_json()
    for record in (was, now):
        record["strategy"] = without_origin(record["strategy"])
    was["budget"] = max(study.spec.budget, spec.budget)
    difference = study.spec.space.difference(spec.space) or first_difference(
        described(was), described(now)
    )
    if difference:
        key, old, new = difference
        raise StudyMismatch(
            f"a stored study goes on only with the settings it was made with: {key} was {old!r}, "
            f"got {new!r}; repeat the old setting, or start afresh with --new (or another name)"
        )
    check_artifacts(study)
    if spec.budget > study.spec.budget:
        study.extend(spec.budget)
    return study
