"""Studies of one database: which there are, and taking one away."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mbtl.errors import InvalidInput, StudyError, check_known
from mbtl.files import from_home
from mbtl.study.artifacts import FolderStore, policy_store
from mbtl.study.ask import is_finished, others, stop_reason
from mbtl.study.checks import replay
from mbtl.study.closing_report import value_of
from mbtl.study.database import check_path, database_file, fixed_url, shown
from mbtl.study.leases import Presence, Watch
from mbtl.study.state import StudyState
from mbtl.study.storage import SqlLog, study_names


@dataclass(frozen=True)
class StudyEntry:
    """One study of a database.

    Attributes:
        name: within its database.
        problem: id of its CMDP; empty for none.
        strategy: its name.
        told: rows told.
        failed: trainings that failed, or were ended early.
        open: picks that wait for an answer.
        budget: trainings that it may ask for.
        units: of them that were asked for.
        steps: environment steps that it may spend; None: they are not counted.
        steps_spent: so many are spent; None likewise.
        spent: how much of the budget is asked for, in words.
        value: V, performance, as `Study.value`; None before the first row.
        stop_reason: why nothing more can be asked; None while something can.
        finished: nothing can be asked, and nobody works on a pick.
        created_at: seconds since the epoch.
    """

    name: str
    problem: str
    strategy: str
    told: int
    failed: int
    open: int
    budget: int
    units: float
    steps: int | None
    steps_spent: float | None
    spent: str
    value: float | None
    stop_reason: str | None
    finished: bool
    created_at: float


def list_studies(storage: str | Path) -> list[StudyEntry]:
    """The studies of a database, oldest first; each of them is read.

    Args:
        storage: path of the SQLite file (or of the folder that holds `study.db`), or a URL.

    Raises:
        StorageError: no database there, or a damaged one.
    """
    address = database_at(storage)
    found = (entry_of(address, name) for name in study_names(address))
    return [entry for entry in found if entry is not None]


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
        StudyError: there is none, or somebody runs it just now.
        InvalidInput: there are several and no name is given, or none has that name.
    """
    log, state = opened(storage, name)
    watch = Watch(log, Presence(database_file(log.url)).is_gone)
    # leases without end are those of ask and tell, whose programs may be long gone
    if held := others(state, watch, "", for_ever=False):
        raise StudyError(
            f"a study that is run is not deleted, and {log.study!r} is run by {', '.join(held)}; "
            "end that first, or wait until its leases have ended"
        )
    store = policy_store(log.url, artifacts)
    log.delete()
    if isinstance(store, FolderStore) and not keep_policies:
        store.remove(f"policies/{state.uid}")


def opened(storage: str | Path, name: str | None) -> tuple[SqlLog, StudyState]:
    """The log of a study, and what it says; `load_study` describes arguments and errors."""
    address = database_at(storage)
    log = SqlLog(address, chosen_name(address, name))
    state = replay(log.read())
    if not state.seq:  # somebody has just deleted it
        raise StudyError(f"there is no study {log.study!r} in {shown(address)}")
    return log, state


def database_at(storage: str | Path) -> str:
    """The URL of a database; of a folder that holds `study.db`, of that."""
    check_path(storage)
    folder = from_home(storage)
    is_folder = "://" not in str(storage) and folder.is_dir()
    return fixed_url(folder / "study.db" if is_folder else storage)


def chosen_name(address: str, name: str | None) -> str:
    """The name, if there is such a study; the only one where none is given.

    Raises:
        InvalidInput: there are several and no name is given, or none has that name.
        StudyError: there is none.
    """
    names = study_names(address)
    if name is not None:
        check_known("study", name, names)
        return name
    if not names:
        raise StudyError(
            f"{shown(address)} holds no study; `mbtl run` and mbtl.create_study(..., storage=...) "
            "make one"
        )
    if len(names) > 1:
        raise InvalidInput(
            f"{shown(address)} holds {len(names)} studies ({', '.join(names)}); choose one "
            "with name= (--name)"
        )
    return names[0]


def entry_of(address: str, name: str) -> StudyEntry | None:
    """One study of a database, which is read; None where somebody has just deleted it."""
    state = replay(SqlLog(address, name).read())
    if not state.seq:
        return None
    spec = state.spec
    return StudyEntry(
        name,
        spec.problem,
        str(spec.selector["name"]),
        len(state.rows),
        len(state.failures),
        len(state.open_picks),
        spec.budget,
        state.paid,
        spec.steps,
        None if spec.steps is None else state.bill().total,
        state.spent_words(),
        value_of(state) if state.rows else None,
        stop_reason(state),
        is_finished(state),
        state.created_at,
    )
