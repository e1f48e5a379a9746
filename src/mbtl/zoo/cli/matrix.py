"""`mbtl matrix`: build transfer matrices, and see which there are and what they hold."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich import box
from rich.table import Table
from rich.text import Text

from mbtl.cli.common import JsonFlag, interruptible, print_json, printer
from mbtl.problems import cmdp_ids
from mbtl.report.reference import REFERENCE_NAMES
from mbtl.zoo.benchmark import (
    RowSource,
    TransferMatrix,
    levels,
    nominal_source,
    open_matrix,
    reference_levels,
    shipped_matrices,
)
from mbtl.zoo.benchmark.shipped import load_by_id
from mbtl.zoo.cli.bench import scaled
from mbtl.zoo.cli.build import build
from mbtl.zoo.cli.multitask import multitask
from mbtl.zoo.cli.shared import Bounds
from mbtl.zoo.cmdps.registry import paper_bounds

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
    bounds: Bounds = None,
    as_json: JsonFlag = False,
) -> None:
    """Show the size and the reference levels of a transfer matrix, per seed.

    Example: mbtl matrix show mine.npz
    """
    source = scaled(open_matrix(matrix), bounds)
    rows = []
    for place, seed in enumerate(_seeds(source)):
        known = levels(source, place)
        rows.append(
            {
                "seed": seed,
                **reference_levels(source, place),
                "grand_mean": known.grand_mean,
                "independent": known.independent,
                "oracle_transfer": known.oracle_transfer,
            }
        )
    facts = _facts(source)
    if as_json:
        print_json({"matrix": matrix, "n": source.n, **facts, "seeds": rows})
        return
    title = Text(f"{matrix}: N = {source.n}")
    table = Table(title=title, box=box.SIMPLE, padding=(0, 1), show_edge=False)  # 80 columns
    heads = {**REFERENCE_NAMES, "independent": "Independent", "oracle_transfer": "Oracle Transfer"}
    shown = {key: head for key, head in heads.items() if key in rows[0]}
    for head in ("seed", *shown.values()):
        table.add_column(head.replace(" ", "\n"), justify="right", no_wrap=True)
    for row in rows:
        table.add_row(str(row["seed"]), *(f"{row[key]:.4f}" for key in shown))
    screen = printer()
    screen.print(table)
    for line in _sentences(facts):
        screen.print(line, markup=False, highlight=False)


@matrix_app.command("list")
def list_matrices(
    folder: Annotated[
        Path | None, typer.Option(help="Folder of matrices you built; default: the shipped ones.")
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """List the shipped matrices, and which of them are of the older protocol.

    Example: mbtl matrix list
    """
    matrices = {name: load_by_id(name, folder=folder) for name in shipped_matrices(folder)}
    if as_json:
        print_json(
            {
                "matrices": [
                    {"matrix": name, "n": one.n, "seeds": one.n_seeds, **_facts(one)}
                    for name, one in matrices.items()
                ]
            }
        )
        return
    table = Table(box=box.SIMPLE, padding=0, show_edge=False)
    for head in ("matrix", "N", "seeds", "episodes", "protocol", "reference rows"):
        right = head in ("N", "seeds", "episodes")
        table.add_column(head, justify="right" if right else "left", no_wrap=True)
    for name, one in matrices.items():
        table.add_row(
            Text(name),
            str(one.n) if one.sources is None else f"{len(one.sources)}/{one.n}",
            str(one.n_seeds),
            _episodes(one),
            "halves" if one.measures_apart else "older",
            ", ".join(REFERENCE_NAMES.get(key, key) for key in one.references) or "-",
        )
    screen = printer()
    screen.print(table)
    screen.print(
        "halves: selection sees one half of the episodes, every number shown is of the other.\n"
        "older: selection and report used the same episodes, so V is too high where episodes "
        "differ by luck.\n" + "\n".join(_luck(matrices)),
        style="dim",
    )


def _luck(matrices: Mapping[str, TransferMatrix]) -> list[str]:
    """Which evaluation seeds they have: a sentence, or one for each kind with the names."""
    names: dict[str, list[str]] = {}
    for name, one in matrices.items():
        names.setdefault(one.evaluation_seeds or "not known", []).append(name)
    if len(names) == 1:
        return [f"Evaluation seeds are {kind}." for kind in names]
    return [f"Evaluation seeds are {kind} in {', '.join(some)}." for kind, some in names.items()]


def _episodes(matrix: TransferMatrix) -> str:
    """Per pair, e.g. "50 + 50"; of older files what their recipe says."""
    if matrix.episodes is not None:
        return " + ".join(map(str, matrix.episodes))
    return str(matrix.records[0].get("recipe", {}).get("eval_episodes", "-"))


def _seeds(source: RowSource) -> list[int]:
    """The numbers of the seeds, as the provenance has them; else from 0 on."""
    records = source.records if isinstance(source, TransferMatrix) else []
    known = [record.get("seed") for record in records]
    told = [seed for seed in known if isinstance(seed, int)]
    return told if len(set(told)) == source.n_seeds else list(range(source.n_seeds))


def _facts(source: RowSource) -> dict[str, Any]:
    """What is said of a matrix beside its levels; nothing of a synthetic world."""
    if not isinstance(source, TransferMatrix):
        return {}
    bounds = source.bounds
    return {
        "bounds": [bounds.low, bounds.high],
        "direction": bounds.direction,
        "floor": bounds.floor,
        "scale": str(bounds),
        "paper_bounds": _paper_bounds(source),
        "seen": [float(source.returns.min()), float(source.returns.max())],
        "sources": len(source.problem(1).sources),
        "targets": source.n,
        "episodes": None if source.episodes is None else list(source.episodes),
        "measures_apart": source.measures_apart,
        "evaluation_seeds": source.evaluation_seeds,
        "nominal_policy": _nominal(source),
        "caveat": source.caveat,
    }


def _paper_bounds(source: TransferMatrix) -> tuple[float, float] | None:
    id = source.records[0].get("problem")
    return paper_bounds(str(id)) if id in cmdp_ids() else None


def _nominal(source: TransferMatrix) -> dict[str, Any] | None:
    """The context of the nominal policy, where that is not the nominal context."""
    nominal, trained = source.records[0].get("nominal"), nominal_source(source)
    if nominal is None or trained is None:
        return None
    context, unit = source.space.contexts[trained], source.space.unit[trained]
    same = np.allclose(unit, source.space.encode(nominal), rtol=0.0, atol=1e-9)
    return None if same else dict(context)


def _sentences(facts: dict[str, Any]) -> list[str]:
    """The same for people."""
    if not facts:
        return []
    lines = [_sentence(facts["scale"])]
    if facts["paper_bounds"] is not None:
        low, high = facts["paper_bounds"]
        seen = "{:.0f} to {:.0f}".format(*facts["seen"])
        lines.append(
            f"In the paper 0 is {low:g} and 1 is {high:g}; returns here are {seen}. Scale by "
            f"either with --bounds {low:g},{high:g} or --bounds seen."
        )
    if facts["nominal_policy"] is not None:
        values = ", ".join(f"{name} {value:g}" for name, value in facts["nominal_policy"].items())
        lines.append(
            f"The nominal context was not trained on: its policy is that of the nearest, {values}."
        )
    if facts["measures_apart"] and facts["episodes"]:
        chose, shown = facts["episodes"]
        lines.append(
            f"A selector sees {chose} episodes per pair; these numbers are of {shown} others."
        )
    if facts["evaluation_seeds"] is not None:
        lines.append(f"Evaluation seeds are {facts['evaluation_seeds']}.")
    if facts["caveat"] is not None:
        lines.append(_sentence(facts["caveat"]))
    return lines


def _sentence(clause: str) -> str:
    return f"{clause[0].upper()}{clause[1:]}."
