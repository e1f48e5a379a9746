"""`mbtl reproduce`: the paper's table from our matrices, beside the published numbers."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.table import Table
from rich.text import Text

from mbtl.benchmark.references import NAMES
from mbtl.benchmark.reproduction import METHODS, Reproduced, Value, reproduce
from mbtl.benchmark.shipped import DEFAULT
from mbtl.cli.common import JsonFlag, print_json, printer
from mbtl.errors import InvalidInput

_HEADS = {
    "independent": "Indep.",
    "multitask": "Multi",
    "random": "Random",
    "greedy": "Greedy",
    "mbtl": "MBTL",
    "sequential_oracle": "Seq.or.",
    "oracle_transfer": "Oracle",
}


def reproduce_command(
    cmdp: Annotated[
        list[str] | None,
        typer.Argument(help="Ids of CMDPs; default: all of which there are matrices."),
    ] = None,
    budget: Annotated[int, typer.Option(help="Number of trainings K.")] = 15,
    variant: Annotated[
        str, typer.Option(help="Set of matrices: default, hidden, final, dqn, a2c, ...")
    ] = DEFAULT,
    folder: Annotated[
        Path | None, typer.Option(help="Folder of matrices you built; default: the shipped ones.")
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Print the paper's table from real transfer matrices, beside the published numbers.

    Example: mbtl reproduce cartpole-length --budget 15
    """
    if budget < 1:
        raise InvalidInput(f"--budget must be >= 1, got {budget}")
    rows = reproduce(cmdp or None, budget, variant, folder=folder)
    if not rows:
        raise InvalidInput(
            f"there are no matrices of the variant {variant!r}; build them with `mbtl matrix build`"
        )
    if as_json:
        print_json({"budget": budget, "rows": [asdict(row) for row in rows]})
        return
    screen = printer()
    screen.print(_table(rows, budget))
    for row in rows:
        screen.print(_notes(row), markup=False, highlight=False, soft_wrap=True)


def _table(rows: list[Reproduced], budget: int) -> Table:
    seeds = "/".join(sorted({str(row.n_seeds) for row in rows}))
    table = Table(
        title=Text(f"V at K = {budget}, mean over {seeds} seeds (the paper: 3 trials, K = 15)"),
        box=box.SIMPLE,
        padding=(0, 1, 0, 0),
        show_edge=False,
    )
    table.add_column("CMDP", no_wrap=True)
    for method in METHODS:
        table.add_column(_HEADS[method], justify="right", no_wrap=True)
    for row in rows:
        table.add_row(Text(row.cmdp), *(_mean(row.ours.get(m)) for m in METHODS))
        table.add_row("  sd", *(_std(row.ours.get(m)) for m in METHODS), style="dim")
        if row.published:
            table.add_row("  paper", *(_mean(row.published.get(m)) for m in METHODS), style="dim")
    return table


def _notes(row: Reproduced) -> str:
    stars = ", ".join(f"> {row.k_star_searched}" if k is None else str(k) for k in row.k_star)
    text = f"{row.cmdp}: MBTL reaches max(Independent, Multi-task) after {stars} trainings"
    if row.published_k_star is not None:
        text += f" (paper: {row.published_k_star:g})"
    others = [f"{name} {_mean(v)}" for name, v in row.multitask.items()]
    text += f"; multi-task: {', '.join(others)}" if others else ""
    rows = [f"{NAMES.get(name, name)} {_mean(v)}" for name, v in row.references.items()]
    text += f"\n  for comparison: {', '.join(rows)}"
    return text + (f"\n  note: {row.caveat}" if row.caveat else "")


def _mean(value: Value | None) -> str:
    return "-" if value is None else f"{value.mean:.4f}"


def _std(value: Value | None) -> str:
    return "-" if value is None or value.std is None else f"{value.std:.4f}"
