"""`mbtl bench`: selectors on known transfer matrices; nothing is trained."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from mbtl.cli.common import JsonFlag, print_json, printer
from mbtl.errors import InvalidInput, written
from mbtl.selectors.registry import get_selector
from mbtl.zoo.benchmark.base import RowSource
from mbtl.zoo.benchmark.compare import Step, compare, default_selectors
from mbtl.zoo.benchmark.comparison import Comparison, show_comparison
from mbtl.zoo.benchmark.matrix import TransferMatrix
from mbtl.zoo.benchmark.shipped import open_matrices
from mbtl.zoo.cli.shared import Bounds, bar


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
        typer.Option(
            help="How often a selector that draws at random runs on each matrix seed; all seeds of "
            "a matrix are used in any case."
        ),
    ] = 3,
    against: Annotated[
        str | None,
        typer.Option(
            help="A selector: also show how far each other one is ahead of it on the same matrix "
            "seeds, with intervals."
        ),
    ] = None,
    bounds: Bounds = None,
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
    sources = [scaled(source, bounds) for source in open_matrices(matrix).values()]
    if selectors is None:
        names = default_selectors(sources)
    else:
        names = [name.strip() for name in selectors.split(",") if name.strip()]
    if against is not None and against not in names:
        names.append(against)
    with bar("") as tell:

        def on_step(step: Step) -> None:
            tell(step.done, step.total, step.doing)

        comparison = compare(names, sources, budget, seeds, on_step=on_step)
    rival = None if against is None else _named(comparison, against)
    document = comparison.to_json()
    if rival is not None:
        leads = [comparison.difference(name, rival) for name in comparison.summary.pooled]
        document["differences"] = [lead.to_json() for lead in leads if lead.selector != rival]
    if out is not None:
        text = json.dumps(document, indent=2, allow_nan=False)
        with written(out):
            out.write_text(text + "\n", encoding="utf-8")
    if as_json:
        print_json(document)
    else:
        show_comparison(printer(), comparison, rival)


def _named(comparison: Comparison, given: str) -> str:
    """The name under which a selector ran: one of a file has its own."""
    known = list(comparison.summary.pooled)
    return given if given in known else get_selector(given).name


def scaled(source: RowSource, bounds: str | None) -> RowSource:
    """With other bounds, LOW,HIGH or `seen`; the direction and the floor stay."""
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
