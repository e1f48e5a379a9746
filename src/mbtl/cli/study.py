"""`mbtl study list|show|export`: what is in the runs folder, and what a study found."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.table import Table
from rich.text import Text

from mbtl.cli.common import JsonFlag, console, print_json, printer
from mbtl.errors import InvalidInput, MbtlError, cannot_write
from mbtl.report import summarise_study
from mbtl.report.text import show_causes, show_summary
from mbtl.selectors import get_selector
from mbtl.study import SqlLog, Study, study_names

study_app = typer.Typer(help="List, show and export studies.", no_args_is_help=True)

_Study = Annotated[
    Path, typer.Argument(metavar="STUDY", help="Folder of the study, e.g. runs/NAME.")
]


@study_app.command("list")
def list_studies(
    folder: Annotated[Path, typer.Argument(help="Folder that holds study folders.")] = Path("runs"),
    as_json: JsonFlag = False,
) -> None:
    """List the studies below a folder.

    Example: mbtl study list runs
    """
    rows = []
    for database in sorted(folder.glob("**/study.db")):
        try:
            study = _open(database)
        except MbtlError as error:
            console.print(f"{database.parent}: {error}", style="red", markup=False, soft_wrap=True)
            continue
        state = study.state
        rows.append(
            {
                "study": str(database.parent),
                "problem": study.spec.problem,
                "selector": study.spec.selector["name"],
                "told": len(state.rows),
                "failed": len(state.failures),
                "open": len(state.open_picks),
                "budget": study.spec.budget,
                "value": study.value if state.rows else None,
                "finished": study.is_finished,
            }
        )
    if as_json:
        print_json(rows)
        return
    if not rows:
        printer().print(f"no studies below {folder}; `mbtl run cartpole-length` makes one")
        return
    table = Table(box=box.SIMPLE, show_edge=False)
    for head in ("study", "selector", "told", "failed", "V", "state"):
        table.add_column(head, overflow="fold" if head == "study" else "ellipsis")
    for row in rows:
        condition = "finished" if row["finished"] else f"{row['open']} open" if row["open"] else ""
        value = "-" if row["value"] is None else f"{row['value']:.4f}"
        told = f"{row['told']}/{row['budget']}"
        cells = (row["study"], row["selector"], told, str(row["failed"]), value, condition)
        table.add_row(*map(Text, cells))
    printer().print(table)


@study_app.command("show")
def show(study: _Study, as_json: JsonFlag = False) -> None:
    """Show the picks of a study, V, what one more training should bring, and why picks failed.

    Example: mbtl study show runs/cartpole-length-quick-seed0
    """
    opened = _open(study)
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
    as_json: JsonFlag = False,
) -> None:
    """Write the rows of a study: one line per (source, target), or the summary and rows as JSON.

    Example: mbtl study export runs/cartpole-length-quick-seed0 rows.csv
    """
    import csv
    import json

    from mbtl.cli.common import plain

    if out.suffix not in (".json", ".csv"):
        raise InvalidInput(f"an export ends in .json or .csv, got {out.name!r}")
    opened = _open(study)
    state, space = opened.state, opened.space
    names = [axis.name for axis in space.axes]
    try:
        with out.open("w", encoding="utf-8", newline="") as file:
            if out.suffix == ".json":
                rows = [
                    {
                        "source": r.source,
                        "context": space.context(r.source),
                        "returns": r.returns,
                        "std": r.std,
                        "episodes": r.episodes,
                    }
                    for r in state.rows
                ]
                document = {"summary": summarise_study(opened).to_json(), "rows": rows}
                json.dump(plain(document), file, indent=2)
            else:
                writer = csv.writer(file)
                sources = [f"source_{n}" for n in names]
                targets = [f"target_{n}" for n in names]
                writer.writerow(
                    ["source", "target", *sources, *targets, "return", "std", "episodes"]
                )
                for r in state.rows:
                    home = list(space.context(r.source).values())
                    for t in range(space.n):
                        there = list(space.context(t).values())
                        writer.writerow(
                            [r.source, t, *home, *there, r.returns[t], r.std[t], r.episodes]
                        )
    except OSError as error:
        raise cannot_write(out, error) from error
    if as_json:
        print_json({"written": str(out), "rows": len(state.rows)})
    else:
        printer().print(Text(f"wrote {len(state.rows)} transfer rows to {out}"))


def _open(path: Path) -> Study:
    """A study for reading only: with any selector, so that one of the user's own opens too."""
    place = path / "study.db" if path.is_dir() else path
    name = next(iter(study_names(place)), "study")
    return Study(SqlLog(place, name), get_selector("random"), folder=place.parent, name=name)
