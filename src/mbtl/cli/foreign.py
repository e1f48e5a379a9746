"""`mbtl matrix import`: matrices of others become files of ours."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mbtl.benchmark import levels
from mbtl.benchmark.foreign import LAYOUTS, import_npy
from mbtl.cli.common import JsonFlag, console, print_json
from mbtl.errors import InvalidInput, cannot_write


def import_matrix(
    files: Annotated[
        list[Path], typer.Argument(help="One .npy per seed, returns of shape (source, target).")
    ],
    out: Annotated[Path, typer.Option(help="The .npz file to write.")],
    layout: Annotated[
        str | None, typer.Option(help=f"Grid of the contexts: {', '.join(LAYOUTS)}.")
    ] = None,
    axis: Annotated[
        list[str] | None,
        typer.Option(help="Or name the grid: NAME=V1,V2,... for each axis, the slowest first."),
    ] = None,
    bounds: Annotated[
        str | None,
        typer.Option(help="LOW,HIGH: returns of performance 0 and 1; default: of all."),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Read a transfer matrix of others, so that selectors can be compared on it.

    Example: mbtl matrix import trial0.npy trial1.npy --layout sd-mbtl-walker --out walker.npz

    `mbtl bench --matrix walker.npz` then runs every selector on it.
    """
    if (layout is None) == (axis is None):
        raise InvalidInput("give the grid either as --layout or as one --axis per axis")
    grid = layout if layout is not None else dict(map(_axis, axis or []))
    scale = None if bounds is None else _numbers("--bounds", bounds)
    if scale is not None and len(scale) != 2:
        raise InvalidInput(f"--bounds must be LOW,HIGH, got {bounds!r}")
    pair = None if scale is None else (scale[0], scale[1])
    matrix = import_npy(files, grid, bounds=pair, name=out.name)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(out, error) from error
    matrix.save(out)
    known = levels(matrix, 0)
    if as_json:
        print_json({"file": str(out), "n": matrix.n, "seeds": matrix.n_seeds})
        return
    console.print(
        f"{out}: {matrix.n} contexts, {matrix.n_seeds} seeds; one policy {known.grand_mean:.4f}, "
        f"Independent {known.independent:.4f}, Oracle Transfer {known.oracle_transfer:.4f}; "
        f"{matrix.caveat}",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )


def _axis(text: str) -> tuple[str, list[float]]:
    name, separator, values = text.partition("=")
    if not separator or not name:
        raise InvalidInput(f"--axis must be NAME=V1,V2,..., got {text!r}")
    return name, _numbers("--axis", values)


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InvalidInput(f"{option} takes numbers with commas between, got {text!r}") from None
