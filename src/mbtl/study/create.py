"""Making and opening studies: settings are checked here, once, before anything is stored."""

from __future__ import annotations

import dataclasses
import operator
import uuid
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from mbtl.contexts import Context, ContextSpace
from mbtl.errors import InvalidInput, StudyError, StudyMismatch
from mbtl.objective import Bounds, Direction, direction_named
from mbtl.selectors import Selector, get_selector, selector_names
from mbtl.settings import as_json, first_difference
from mbtl.study.checks import check_spec
from mbtl.study.events import Event
from mbtl.study.places import fixed_url, policy_folder
from mbtl.study.state import StudySpec, replay
from mbtl.study.storage import (
    Conflict,
    EventLog,
    MemoryLog,
    SqlLog,
    study_names,
)
from mbtl.study.study import Study
from mbtl.version import __version__


def create_study(
    space: ContextSpace,
    *,
    budget: int,
    selector: str | Selector = "auto",
    bounds: tuple[float, float] | Bounds | None = None,
    direction: Direction | str = "maximize",
    theta: float | None = None,
    seed: int = 0,
    trial: int = 0,
    stop_value: float | None = None,
    cost_budget: float | None = None,
    costs: ArrayLike | Callable[[Context], float] | None = None,
    repeats: int = 1,
    risk: float = 1.0,
    eval_targets: int | None = None,
    stop_gain: float | None = None,
    stop_confidence: float = 0.9,
    stop_left: float | None = None,
    best_return: float | None = None,
    storage: str | Path | None = None,
    artifacts: str | Path | None = None,
    name: str = "study",
    problem: str = "",
    settings: Mapping[str, Any] | None = None,
    load_if_exists: bool = False,
) -> Study:
    """Start a study.

    Args:
        space: the contexts; sources and targets.
        budget: number of trainings K, 1..N (times `repeats`).
        selector: a registered name, or an object with `propose`. "auto" heeds all that follows;
            of costs, repeats, risk and noise the paper's selectors know nothing.
        bounds: (low, high) of the returns, or `Bounds`, whose direction and floor then count; None
            takes the range told so far.
        direction: "maximize" or "minimize" the returns; "max" and "min" will do.
        theta: slope of the linear gap, performance per grid step; None: 0.005, or 0.5/(N-1) for
            N > 100.
        seed: root of the seed tree.
        trial: repetition; another trial has other training seeds.
        stop_value: end when V reaches this performance; needs bounds.
        cost_budget: end when the costs told add up to this; with `costs`, no source is proposed
            that costs more than what is left.
        costs: (N,) expected cost of a training on each context, or a function of the context. The
            selector then maximises gain per cost.
        repeats: trainings allowed on one context, with other seeds, where their luck is worth it.
        risk: V is the mean over this share of the targets, those that do worst; 1 for all.
        eval_targets: evaluate each policy on so many targets, its source among them
            (`Pick.targets`); None for all.
        stop_gain: end when one more training gains less than this in V ...
        stop_confidence: ... with at least this probability, as the selector predicts it after
            three rows or more. V counts as what it surely is, with this probability.
        stop_left: end when nothing is left to gain: V is so near to what `best_return` is worth, or
            the selector predicts that all trainings left together gain less than this in V.
        best_return: the largest return there is (smallest, if minimised), if you know it.
        storage: path of an SQLite file or an SQLAlchemy URL; None keeps the study in memory.
        artifacts: folder that policies are saved below; None: the one of the database, where that
            is a file. Give it again to `load_study`.
        name: name of the study within its storage.
        problem: id of the problem, to refuse a study of another one.
        settings: JSON-able record of the training recipe, to refuse a study of another one.
        load_if_exists: go on with an existing study of the same name and the same settings; a
            larger budget extends it.

    Raises:
        InvalidInput: budget out of range, bounds reversed, unknown selector, ...
        StudyError: a study of this name exists and `load_if_exists` is False.
        StudyMismatch: it exists with other settings.
        StorageError: the storage cannot be written.
    """
    chosen = get_selector(selector)
    if not isinstance(space, ContextSpace):
        raise InvalidInput(
            f"space must be a ContextSpace, got {type(space).__name__}; build one with "
            "ContextSpace.grid or ContextSpace.points"
        )
    budget, seed = _whole("budget", budget), _whole("seed", seed)
    trial = _whole("trial", trial)
    direction, theta = direction_named(direction), _finite("theta", theta)
    floor = None
    if isinstance(bounds, Bounds):
        direction, floor = bounds.direction, bounds.floor
    pair = _pair("bounds", bounds)
    if pair is not None:
        Bounds(*pair, direction, floor)
    stop_value = _finite("stop_value", stop_value)
    if stop_value is not None and bounds is None:
        raise InvalidInput("stop_value is a performance, so it needs bounds=(low, high); got none")
    if stop_value is not None and stop_value > 1.0:
        raise InvalidInput(
            f"stop_value is a performance, at most 1 (the better bound), got {stop_value!r}"
        )
    cost_budget = _real("cost_budget", cost_budget)
    stop_gain = _real("stop_gain", stop_gain)
    stop_confidence = _real("stop_confidence", stop_confidence)
    if seed < 0 or trial < 0:
        raise InvalidInput(f"seed and trial must be >= 0, got {seed} and {trial}")
    _check_wishes(chosen, repeats, stop_gain, stop_confidence, bounds)
    if stop_left is not None and bounds is None:
        raise InvalidInput("stop_left is in performance, so it needs bounds=(low, high); got none")
    spec = StudySpec(
        space,
        budget,
        describe_selector(chosen),
        pair,
        direction,
        theta,
        seed,
        trial,
        stop_value,
        cost_budget,
        problem,
        as_json("settings", settings or {}),
        _whole("repeats", repeats),
        _costs(costs, space),
        _real("risk", risk),
        _target_count(eval_targets, space.n),
        stop_gain,
        stop_confidence,
        _real("stop_left", stop_left),
        _finite("best_return", best_return),
        floor,
    )
    check_spec(spec)
    address = None if storage is None else fixed_url(storage)
    log: EventLog = MemoryLog() if address is None else SqlLog(address, name, create=True)
    folder = policy_folder(address, artifacts)
    created = {"spec": spec.to_json(), "version": __version__, "uid": uuid.uuid4().hex[:8]}
    event = Event("created", created)
    try:
        log.append(event, after=0)
    except Conflict:
        study = Study(log, chosen, folder=folder, name=name)
        if not load_if_exists:
            raise StudyError(
                f"a study named {name!r} exists in {storage}; pass load_if_exists=True to go on "
                "with it, or choose another name"
            ) from None
        if spec.budget > study.spec.budget:
            _check_same(dataclasses.replace(study.spec, budget=spec.budget), spec)
            study.extend(spec.budget)
        _check_same(study.spec, spec)
        return study
    return Study(log, chosen, folder=folder, name=name)


def load_study(
    storage: str | Path,
    name: str | None = None,
    *,
    selector: Selector | None = None,
    artifacts: str | Path | None = None,
) -> Study:
    """Open an existing study.

    Args:
        storage: path of the SQLite file (or of the folder that holds `study.db`), or a URL.
        name: name of the study; needed only when the storage holds several.
        selector: the selector object, for studies made with one that has no registered name.
        artifacts: folder that policies are saved below, as it was given to `create_study`.

    Raises:
        StorageError: no database there, or a damaged one.
        StudyError: no such study, or several and no name.
    """
    place = storage
    if "://" not in str(storage) and Path(storage).is_dir():
        place = Path(storage) / "study.db"
    place = fixed_url(place)
    if name is None:
        names = study_names(place)
        if len(names) != 1:
            raise StudyError(
                f"{place} holds {len(names)} studies ({', '.join(names)}); give a name"
            )
        name = names[0]
    log = SqlLog(place, name)
    created = next(iter(log.read()), None)
    if created is None or created.kind != "created":
        raise StudyError(f"there is no study {name!r} in {place}; it holds {study_names(place)}")
    spec = replay([created]).spec
    assert spec is not None
    if selector is None:
        registered = str(spec.selector["name"])
        if registered not in selector_names():
            raise StudyError(
                f"this study was made with the selector {registered!r}; give it as selector="
            )
        selector = get_selector(registered)
    if describe_selector(selector) != dict(spec.selector):
        raise StudyMismatch(
            f"this study was made with the selector {dict(spec.selector)}, got "
            f"{describe_selector(selector)}; give the same one as selector="
        )
    return Study(log, selector, folder=policy_folder(place, artifacts), name=name)


def describe_selector(selector: Selector) -> dict[str, Any]:
    """Name and settings of a selector, JSON-able and the same in every process."""

    def plain(value: Any) -> Any:
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            changed = {f.name: _changed(value, f) for f in dataclasses.fields(value)}
            return {name: plain(v) for name, v in changed.items() if v is not _KEPT}
        if isinstance(value, (list, tuple)):
            return [plain(item) for item in value]
        if value is None or isinstance(value, (str, int, float, bool)):
            return value
        return getattr(value, "__qualname__", type(value).__qualname__)

    settings = plain(selector)
    if not isinstance(settings, dict):
        settings = {"class": settings}
    return {**settings, "name": selector.name}


_KEPT = object()


def _changed(value: Any, field: dataclasses.Field[Any]) -> Any:
    """The value of a field, or `_KEPT` where it is the default.

    Only changes are stored, so a selector may gain a setting and old studies still open.
    """
    given = getattr(value, field.name)
    default = field.default
    if default is dataclasses.MISSING and field.default_factory is not dataclasses.MISSING:
        default = field.default_factory()
    return _KEPT if default is not dataclasses.MISSING and given == default else given


def _costs(
    costs: ArrayLike | Callable[[Context], float] | None, space: ContextSpace
) -> tuple[float, ...] | None:
    if costs is None:
        return None
    given = [costs(context) for context in space.contexts] if callable(costs) else costs
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"costs must be numbers, one per context ({error})") from error
    if array.shape != (space.n,):
        raise InvalidInput(f"costs must be {space.n} numbers, one per context, got {array.shape}")
    return tuple(array.tolist())


def _check_wishes(
    selector: Selector,
    repeats: int,
    stop_gain: float | None,
    stop_confidence: float,
    bounds: tuple[float, float] | Bounds | None,
) -> None:
    """Repeated trainings and the stopping rule need a selector that knows of them."""
    if repeats != 1 and not getattr(selector, "retrains", False):
        raise InvalidInput(
            f"repeats needs a selector that trains a context again, such as 'auto', got "
            f"{selector.name!r} with repeats={repeats!r}"
        )
    if not stop_confidence < 1.0:
        raise InvalidInput(f"stop_confidence is a probability in (0, 1), got {stop_confidence!r}")
    if stop_gain is None:
        return
    if bounds is None:
        raise InvalidInput("stop_gain is in performance, so it needs bounds=(low, high); got none")
    if not getattr(selector, "predicts_chances", False):
        raise InvalidInput(
            f"stop_gain needs a selector that predicts chances of a gain, such as 'auto', got "
            f"{selector.name!r}"
        )


def _target_count(count: int | None, n: int) -> int | None:
    if count is None:
        return None
    count = _whole("eval_targets", count)
    if not 1 <= count <= n:
        raise InvalidInput(f"eval_targets must be from 1 to {n}, got {count}")
    return count


def _whole(name: str, number: Any) -> int:
    try:
        return operator.index(number)
    except TypeError:
        raise InvalidInput(f"{name} must be a whole number, got {number!r}") from None


@overload
def _real(name: str, number: None) -> None: ...


@overload
def _real(name: str, number: float) -> float: ...


def _real(name: str, number: float | None) -> float | None:
    """A finite number > 0, as Python's own, or None."""
    value = None if number is None else _float(name, number)
    if value is not None and not (np.isfinite(value) and value > 0):
        raise InvalidInput(f"{name} must be finite and > 0, got {number!r}")
    return value


def _finite(name: str, number: float | None) -> float | None:
    """A finite number, as Python's own, or None."""
    value = None if number is None else _float(name, number)
    if value is not None and not np.isfinite(value):
        raise InvalidInput(f"{name} must be finite, got {number!r}")
    return value


def _float(name: str, number: Any) -> float:
    try:
        return float(number)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInput(f"{name} must be a number, got {number!r}") from None


def _pair(name: str, pair: Iterable[float] | None) -> tuple[float, float] | None:
    if pair is None:
        return None
    try:
        low, high = pair
        return float(low), float(high)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInput(f"{name} must be two numbers (low, high), got {pair!r}") from None


def _check_same(stored: StudySpec, given: StudySpec) -> None:
    if stored.space != given.space:
        difference: tuple[str, Any, Any] | None = ("space", stored.space, given.space)
    else:
        difference = first_difference(stored.to_json(), given.to_json())
    if difference:
        key, was, now = difference
        raise StudyMismatch(
            f"a stored study goes on only with the settings it was made with: {key} was {was!r}, "
            f"got {now!r}; repeat the old setting, or start afresh with --new (or another name)"
        )
