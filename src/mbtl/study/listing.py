"""Studies of one database: which there are, and taking one away."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mbtl.errors import StudyError, unknown_name
from mbtl.files import from_home
from mbtl.study.artifacts import FolderStore
from mbtl.study.ask import stop_reason
from mbtl.study.closing_report import value_of
from mbtl.study.database import (
    WRITES,
    as_url,
    check_path,
    database_errors,
    open_database,
    shown,
)
from mbtl.study.leases import Watch
from mbtl.study.liveness import Presence
from mbtl.study.places import database_file, fixed_url, policy_store
from mbtl.study.state import StudyState, replay
from mbtl.study.storage import SqlLog, study_names


@dataclass(frozen=True)
class StudyEntry:
    """One study of a database.

    Attributes:
        name: within its database.
        problem: id of its CMDP; empty for none.
        selector: name of its selector.
        told: rows told.
        failed: trainings that failed, or were ended early.
        open: picks that wait for an answer.
        budget: trainings that it may ask for.
        value: V, performance, as `Study.value`; None before the first row.
        stop_reason: why nothing more can be asked; None while something can.
        created_at: seconds since the epoch.
    """

    name: str
    problem: str
    selector: str
    told: int
    failed: int
    open: int
    budget: int
    value: float | None
    stop_reason: str | None
    created_at: float


def list_studies(storage: str | Path) -> list[StudyEntry]:
    """The studies of a database, oldest first; each of them is read.

    Args:
        storage: path of the SQLite file (or of the folder that holds `study.db`), or a URL.

    Raises:
        StorageError: no database there, or a damaged one.
    """
    address = database_at(storage)
    return [_entry_of(name, SqlLog(address, name)) for name in study_names(address)]


def delete_study(
    storage: str | Path,
    name: str | None = None,
    *,
    artifacts: str | Path | None = None,
    keep_policies: bool = False,
) -> None:
    """Remove a study from its database for ever, and the folder of its policies.

    Args:
        storage: path of the SQLite file (or of the folder that holds `study.db`), or a URL.
        name: name of the study; needed only when the storage holds several.
        artifacts: where its policies are, as it was given to `create_study`.
        keep_policies: leave them; those in an object store are never removed.

    Raises:
        StorageError: no database there, or it cannot be written.
        StudyError: no such study, several and no name, or somebody runs it just now.
    """
    from sqlalchemy import delete

    address = database_at(storage)
    name = chosen_name(address, name)
    log = SqlLog(address, name)
    state = replay(log.read())
    _check_idle(state, Watch(log, Presence(database_file(address)).is_gone), name)
    store = policy_store(address, artifacts)
    engine, table, heartbeats = open_database(as_url(address), create=False)
    try:
        writer = engine.execution_options(**{WRITES: True})
        with database_errors(address), writer.begin() as connection:
            for one in (table, heartbeats):
                connection.execute(delete(one).where(one.c.study == name))
    finally:
        engine.dispose()
    if isinstance(store, FolderStore) and not keep_policies:
        store.remove(f"policies/{state.uid}")


def database_at(storage: str | Path) -> str:
    """The URL of a database; of a folder that holds `study.db`, of that."""
    place = storage
    check_path(place)
    if "://" not in str(storage) and from_home(storage).is_dir():
        place = from_home(storage) / "study.db"
    return fixed_url(place)


def chosen_name(address: str, name: str | None) -> str:
    """The name, if there is such a study; the only one where none is given.

    Raises:
        StudyError: none, several and no name, or no such study.
    """
    names = study_names(address)
    if name is None and len(names) != 1:
        raise StudyError(
            f"{shown(address)} holds {len(names)} studies ({', '.join(names)}); give a name"
            if names
            else f"{shown(address)} holds no study; mbtl.create_study(..., storage=...) makes one"
        )
    if name is not None and name not in names:
        raise StudyError(f"{unknown_name('study', name, names)}")
    return names[0] if name is None else name


def _check_idle(state: StudyState, watch: Watch, name: str) -> None:
    """Leases without end are those of ask and tell, whose programs may be long gone."""
    held = [
        pick.lease.worker
        for pick in state.open_picks.values()
        if pick.lease is not None
        and pick.lease.seconds is not None
        and not watch.is_stale(pick.lease)
    ]
    if held:
        workers = ", ".join(sorted(set(held)))
        raise StudyError(
            f"a study that is run is not deleted, and {name!r} is run by {workers}; "
            "end that first, or wait until its leases have ended"
        )


def _entry_of(name: str, log: SqlLog) -> StudyEntry:
    state = replay(log.read())
    spec = state.spec
    return StudyEntry(
        name,
        spec.problem,
        str(spec.selector["name"]),
        len(state.rows),
        len(state.failures),
        len(state.open_picks),
        spec.budget,
        value_of(state) if state.rows else None,
        stop_reason(state),
        state.created_at,
    )
