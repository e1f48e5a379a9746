"""`mbtl matrix`: build transfer matrices (`build`), and see what they hold (`show`)."""

from __future__ import annotations

from typing import Annotated

import typer
from rich import box
from rich.table import Table
from rich.text import Text

from mbtl.benchmark import levels, open_matrix
from mbtl.cli.build import build
from mbtl.cli.common import JsonFlag, interruptible, print_json, printer
from mbtl.cli.multitask import multitask

matrix_app = typer.Typer(help="Build transfer matrices and look at them.", no_args_is_help=True)
matrix_app.command("build")(interruptible(build))
matrix_app.command("multitask")(interruptible(multitask))


@matrix_app.command("show")
def show(
    matrix: Annotated[
        str,
        typer.Argument(
            help="A path ending in .npz, the id of a shipped matrix, or synthetic:NAME."
        ),
    ],
    as_json: JsonFlag = False,
) -> None:
    """Show the size and the reference levels of a transfer matrix, per seed.

    Example: mbtl matrix show mine.npz
    """
    source = open_matrix(matrix)
    rows = []
    for seed in range(source.n_seeds):
        known = levels(source, seed)
        rows.append(
            {
                "seed": seed,
                "grand_mean": known.grand_mean,
                "independent": known.independent,
                "oracle_transfer": known.oracle_transfer,
            }
        )
    if as_json:
        print_json({"matrix": matrix, "n": source.n, "seeds": rows})
        return
    table = Table(title=Text(f"{matrix}: N = {source.n}"), box=box.SIMPLE, show_edge=False)
    for head in ("seed", "grand mean", "Independent", "Oracle Transfer"):
        table.add_column(head, justify="right")
    for row in rows:
        table.add_row(str(row["seed"]), *(f"{v:.4f}" for k, v in row.items() if k != "seed"))
    printer().print(table)
