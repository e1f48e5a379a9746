"""`mbtl study list|show|export`: what is in the runs folder, and what a study found."""

from __future__ import annotations

import csv
import json
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.table import Table
from rich.text import Text

from mbtl.arrays import plain
from mbtl.cli.common import JsonFlag, console, print_json, printer
from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, MbtlError, written
from mbtl.report import summarise_study
from mbtl.report.text import show_causes, show_summary
from mbtl.selectors import get_selector
from mbtl.study import SqlLog, Study, study_names
from mbtl.study.artifacts import policy_store
from mbtl.study.checks import replay
from mbtl.study.database import shown
from mbtl.study.listing import chosen_name, database_at, entry_of
from mbtl.study.storage import names_in

study_app = typer.Typer(help="List, show and export studies.", no_args_is_help=True)

_Study = Annotated[
    str,
    typer.Argument(
        metavar="STUDY", help="Folder of the study, e.g. runs/NAME, its file, or a URL."
    ),
]
_Name = Annotated[
    str | None, typer.Option(help="Name of the study, where its database holds several.")
]


@study_app.command("list")
def list_studies(
    place: Annotated[
        str,
        typer.Argument(metavar="FOLDER|URL", help="Folder of studies, or one database: file, URL."),
    ] = "runs",
    as_json: JsonFlag = False,
) -> None:
    """List the studies below a folder, or of one database.

    Example: mbtl study list runs

    Of a server: mbtl study list postgresql+psycopg://me@db/studies
    """
    rows: list[dict[str, Any]] = []
    for database in _databases(place):
        with _reported(database):
            for name in study_names(database):
                with _reported(database):
                    if (entry := entry_of(database_at(database), name)) is None:
                        continue
                    rows.append({"study": _shown_at(database), **asdict(entry)})
    if as_json:
        print_json(rows)
        return
    if not rows:
        where = f"in {shown(place)}" if "://" in place else f"below {place}"
        printer().say(f"no studies {where}; `mbtl run cartpole-length` makes one")
        return
    table = Table(box=box.SIMPLE, show_edge=False)
    for head in ("study", "strategy", "asked for", "failed", "V", "state"):
        table.add_column(head, overflow="fold" if head == "study" else "ellipsis")
    for row in rows:
        condition = "finished" if row["finished"] else f"{row['open']} open" if row["open"] else ""
        value = "-" if row["value"] is None else f"{row['value']:.4f}"
        alone = sum(other["study"] == row["study"] for other in rows) == 1
        place = row["study"] if alone else f"{row['study']} --name {shlex.quote(row['name'])}"
        cells = (place, row["strategy"], row["spent"], str(row["failed"]), value, condition)
        table.add_row(*map(Text, cells))
    printer().print(table)


@study_app.command("show")
def show(study: _Study, name: _Name = None, as_json: JsonFlag = False) -> None:
    """Show the picks of a study, V, whether one policy is enough, and why picks failed.

    Example: mbtl study show runs/cartpole-length-quick-seed0

    While others train: watch -n 5 mbtl study show runs/cartpole-length-full-seed0
    """
    opened = open_study(study, name)
    summary = summarise_study(opened)
    if as_json:
        print_json(summary.to_json())
    else:
        show_summary(printer(), summary, opened.space)
        show_causes(printer(), summary, opened.space)


@study_app.command("export")
def export(
    study: _Study,
    out: Annotated[Path, typer.Argument(help="File to write, ending in .json or .csv.")],
    name: _Name = None,
    as_json: JsonFlag = False,
) -> None:
    """Write the rows of a study: one line per policy and target, or the summary and rows as JSON.

    A policy is said by the contexts it was trained on (their numbers), the policy it began with
    and the units of its training. Policies are numbered from 0 in the order of the lines.

    Example: mbtl study export runs/cartpole-length-quick-seed0 rows.csv
    """
    if out.suffix not in (".json", ".csv"):
        raise InvalidInput(f"an export ends in .json or .csv, got {out.name!r}")
    opened = open_study(study, name)
    state, space = opened.state, opened.space
    rows: list[dict[str, Any]] = [
        {
            "policy": i,
            "sources": r.sources,
            "contexts": [space.context(s) for s in r.sources],
            "start": None if r.start is None else state.place_of(r.start),
            "length": r.length,
            "returns": r.returns,
            "std": r.std,
            "episodes": r.episodes,
        }
        for i, r in enumerate(state.rows)
    ]
    with written(out), out.open("w", encoding="utf-8", newline="") as file:
        if out.suffix == ".json":
            document = {"summary": summarise_study(opened).to_json(), "rows": rows}
            json.dump(plain(document), file, indent=2)
        else:
            csv.writer(file).writerows(_lines(rows, space))
    if as_json:
        print_json({"written": str(out), "rows": len(rows)})
    else:
        printer().print(Text(f"wrote {len(rows)} transfer rows to {out}"))


def _lines(rows: list[dict[str, Any]], space: ContextSpace) -> Iterator[list[Any]]:
    """A head, and a line per policy and target."""
    names = [axis.name for axis in space.axes]
    there = [f"{side}_{name}" for side in ("source", "target") for name in names]
    there.insert(len(names), "target")
    yield ["policy", "sources", "start", "length", *there, "return", "std", "episodes"]
    for row in rows:
        how = [row["policy"], " ".join(map(str, row["sources"])), row["start"], row["length"]]
        one = len(row["sources"]) == 1  # several have no values of their own
        home = row["contexts"][0].values() if one else [None] * len(names)
        for t, target in enumerate(space.contexts):
            measured = (row["returns"][t], row["std"][t], row["episodes"])
            yield [*how, *home, t, *target.values(), *measured]


def _databases(place: str) -> list[str | Path]:
    if "://" in place:
        study_names(place)  # none there is no empty list
        return [place]
    folder = Path(place)
    if folder.is_file():
        return [folder]
    files = sorted(folder.glob("**/*.db"))  # other programs have such, too
    return [file for file in files if file.name == "study.db" or names_in(file)]


def _shown_at(database: str | Path) -> str:
    """What a user types for it."""
    if isinstance(database, str):
        return shown(database)
    return str(database.parent if database.name == "study.db" else database)


@contextmanager
def _reported(database: str | Path) -> Iterator[None]:
    """A study that cannot be read does not hide the others."""
    try:
        yield
    except MbtlError as error:
        console.say(f"{_shown_at(database)}: {error}", "red")


def open_study(path: str | Path, name: str | None) -> Study:
    """A study for reading only: with any strategy, so that one of the user's own opens too."""
    place = database_at(path)
    log = SqlLog(place, chosen_name(place, name))
    store, state = policy_store(place, None), replay(log.read())
    return Study(log, get_selector("random"), folder=store, name=log.study, state=state)
