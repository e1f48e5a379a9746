"""`mbtl bench`: selectors on known transfer matrices; nothing is trained."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from mbtl.benchmark.base import RowSource
from mbtl.benchmark.catalogue import open_matrices
from mbtl.benchmark.compare import RANDOM, Step, compare, default_selectors
from mbtl.benchmark.matrix import TransferMatrix
from mbtl.benchmark.records import (
    Comparison,
    Estimate,
    MatrixSummary,
    SelectorSummary,
    Trainings,
)
from mbtl.benchmark.references import NAMES
from mbtl.cli.common import JsonFlag, console, print_json, printer
from mbtl.errors import InvalidInput, cannot_write


def bench(
    matrix: Annotated[
        list[str],
        typer.Option(
            help="A path ending in .npz, the id of a shipped matrix, `all` (every shipped one with "
            "one axis), or a synthetic world such as synthetic:linear-gap; repeat for more."
        ),
    ],
    selectors: Annotated[
        str | None,
        typer.Option(
            help="Comma-separated names, or file.py:Selector of your own; `oracle` is the "
            "Sequential Oracle. "
            "Default: every selector that can run on the matrices."
        ),
    ] = None,
    budget: Annotated[int, typer.Option(help="Number of trainings K.")] = 15,
    seeds: Annotated[
        int,
        typer.Option(help="Selector seeds per matrix seed; a deterministic selector runs once."),
    ] = 3,
    bounds: Annotated[
        str | None,
        typer.Option(
            help="LOW,HIGH: returns of performance 0 and 1 instead of the matrices' own; or "
            "`seen`: the smallest and largest of each."
        ),
    ] = None,
    as_json: JsonFlag = False,
    out: Annotated[
        Path | None, typer.Option(help="Also write the JSON document to this file.")
    ] = None,
) -> None:
    """Compare selectors on transfer matrices.

    Example: mbtl bench --matrix mine.npz --selectors random,greedy,mbtl,oracle --budget 15
    """
    if out is not None and (out.is_dir() or not _writable(out.parent)):
        raise InvalidInput(
            f"--out must be a file in a folder that can be written, got {str(out)!r}"
        )
    sources = [_scaled(source, bounds) for source in open_matrices(matrix).values()]
    if selectors is None:
        names = default_selectors(sources)
    else:
        names = [name.strip() for name in selectors.split(",") if name.strip()]
    with Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    ) as progress:
        task = progress.add_task("starting", total=None)

        def show(step: Step) -> None:
            progress.update(task, description=step.doing, completed=step.done, total=step.total)

        comparison = compare(names, sources, budget, seeds, on_step=show)
    if out is not None:
        _write(comparison, out)
    if as_json:
        print_json(comparison.to_json())
    else:
        _show(comparison)


def _scaled(source: RowSource, bounds: str | None) -> RowSource:
    """With other bounds; the direction and the floor stay."""
    if bounds is None:
        return source
    if not isinstance(source, TransferMatrix):
        raise InvalidInput(f"--bounds is for matrices of returns, got {source.name!r}")
    if bounds == "seen":
        low, high = float(source.returns.min()), float(source.returns.max())
    else:
        try:
            low, high = map(float, bounds.split(","))
        except ValueError:
            raise InvalidInput(f"--bounds is LOW,HIGH or seen, got {bounds!r}") from None
    return replace(source, bounds=replace(source.bounds, low=low, high=high))


def _writable(folder: Path) -> bool:
    return folder.is_dir() and os.access(folder, os.W_OK)


def _write(comparison: Comparison, path: Path) -> None:
    text = json.dumps(comparison.to_json(), indent=2, allow_nan=False)
    try:
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise cannot_write(path, error) from error


def _show(comparison: Comparison) -> None:
    """Print one table per matrix, and the pooled one when there are several."""
    screen = printer()
    summary = comparison.summary
    for name, one in summary.matrices.items():
        seeds = f"{one.n_seeds} seed" + ("s" if one.n_seeds > 1 else "")
        table = _table(f"{name} ({seeds}), K = {summary.budget}", one.selectors, summary.budget)
        table.caption = "\n".join(captions(one))
        table.caption_justify = "left"
        screen.print(table)
    if len(summary.matrices) > 1:
        title = f"pooled over {len(summary.matrices)} matrices, K = {summary.budget}"
        screen.print(_table(title, summary.pooled, summary.budget))
    notes = [
        "[..] 95 % bootstrap interval over matrix seeds (none with one seed).",
        "k*: trainings to reach Independent; k90: 90 % of the way from the grand mean to Oracle "
        "Transfer; geometric means. > is a lower bound: some seeds did not get there within K.",
        "random policy: one policy trained on a random context, the grand mean of the matrix.",
        "closed: share of the distance from Random to the Sequential Oracle.",
    ]
    if RANDOM in summary.pooled:
        notes.append("random: exact expectation over all orders.")
    if "auto" in summary.pooled:
        notes.append(
            "auto: its prior has not seen the family of a matrix, where provenance names its CMDP."
        )
    screen.print("\n".join(notes), style="dim", markup=False, highlight=False)


def captions(one: MatrixSummary) -> list[str]:
    """What stands under a table of selectors: levels, and what must be said of them."""
    rows = [f"{NAMES.get(key, key)} {v:.4f}" for key, v in one.references.items()]
    levels = f"Independent {one.independent:.4f}, Oracle Transfer {one.oracle_transfer:.4f}"
    return [", ".join(rows), levels, *([] if one.caveat is None else [f"Note: {one.caveat}."])]


def _table(title: str, selectors: Mapping[str, SelectorSummary], budget: int) -> Table:
    table = Table(
        title=Text(title), box=box.SIMPLE, padding=0, show_edge=False
    )  # within 80 columns
    table.add_column("selector", no_wrap=True)
    for head in ("V_K", "mean V", "k*", "k90", "k99", "closed\nat K", "closed,\ncurve"):
        table.add_column(head, justify="right", no_wrap=True)
    for name, one in selectors.items():
        table.add_row(
            name,
            _number(one.V_K, 4) + _interval(one.V_K, 3),
            _number(one.V_mean, 4),
            *(_count(trainings, budget) for trainings in (one.k_star, one.k90, one.k99)),
            _number(one.closed_at_K, 2) + _interval(one.closed_at_K, 2),
            _number(one.closed_under_curve, 2),
        )
    return table


def _number(estimate: Estimate, digits: int) -> str:
    return "-" if estimate.value is None else f"{estimate.value:.{digits}f}"


def _interval(estimate: Estimate, digits: int) -> str:
    """On a line of its own, so that the table fits 80 columns."""
    if estimate.low is None or estimate.high is None:
        return ""
    return f"\n\\[{estimate.low:.{digits}f}, {estimate.high:.{digits}f}]"


def _count(trainings: Trainings, budget: int) -> str:
    value = trainings.estimate.value
    if value is None:
        return f">{budget}"
    return f"{'>' if trainings.censored else ''}{value:.1f}"
