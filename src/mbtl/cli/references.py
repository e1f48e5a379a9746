"""`mbtl matrix references`: add the rows without a policy to matrices that are there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from mbtl.arrays import Array
from mbtl.benchmark import TransferMatrix, reference_levels
from mbtl.benchmark.entries import halves
from mbtl.cli.common import JsonFlag, console, print_json
from mbtl.cmdps import CMDP, cmdp_ids, get_cmdp, resolve_cmdp
from mbtl.errors import InvalidInput
from mbtl.provenance import here
from mbtl.seeds import MATRIX_TRIAL, evaluation_seed
from mbtl.trainer import ReferenceTrainer, Trainer, checked_returns


def references(
    files: Annotated[list[Path], typer.Argument(help="Files that `mbtl matrix build` wrote.")],
    problem: Annotated[
        str | None,
        typer.Option(help="module:problem of your own CMDP; ours are known by their provenance."),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Add reference rows to matrix files: random actions, and the system without a controller.

    Nothing is trained. They are played in the episodes in which the policies were evaluated. The
    nominal context is noted, too, so that its policy can be shown.

    Example: mbtl matrix references matrices/eco-penetration-seed0.npz
    """
    results = []
    for file in files:
        matrix = TransferMatrix.load(file)
        record = matrix.records[0]
        cmdp = _cmdp(file, record) if problem is None else resolve_cmdp(problem)
        if cmdp.space != matrix.space:
            raise InvalidInput(
                f"{file} has other contexts than {cmdp.id!r}; give its own --problem"
            )
        nominal = None if cmdp.nominal is None else dict(cmdp.nominal)
        added: dict[str, Any] = {"provenance": {**record, "nominal": nominal}}
        rows = _rows(cmdp, matrix, record)
        if rows:
            added["references"] = {name: row.astype(np.float32) for name, row in rows.items()}
            added["provenance"]["references"] = here()
        now = replace(matrix, **added)
        now.save(file)
        results.append({"file": str(file), **reference_levels(now, 0)})
        shown = ", ".join(
            f"{k.replace('_', ' ')} {v:.4f}" for k, v in reference_levels(now, 0).items()
        )
        console.print(f"{file}: {shown}", markup=False, highlight=False, soft_wrap=True)
    if as_json:
        print_json({"matrices": results})


def _cmdp(file: Path, record: Mapping[str, Any]) -> CMDP:
    """One of ours, with the switches of a file."""
    id, switches = record.get("problem"), dict(record.get("switches", {}))
    if id not in cmdp_ids():
        raise InvalidInput(
            f"{file} names no CMDP of ours, got {id!r}; give yours as --problem module:problem"
        )
    every = switches.pop("every", 1)
    cmdp = get_cmdp(str(id), **switches)
    return cmdp if every == 1 else cmdp.every(every)


def _rows(cmdp: CMDP, matrix: TransferMatrix, record: Mapping[str, Any]) -> dict[str, Array]:
    """(1, H, N) by name; none where the trainer has none, or the CMDP is another one by now."""
    if record.get("version", cmdp.version) != cmdp.version:
        console.print(
            f"{matrix.name}: only its nominal context is noted, since {cmdp.id} is of version "
            f"{cmdp.version} now and the file of {record['version']}: build it again",
            markup=False,
        )
        return {}
    known = record.get("recipe", {}).get("eval_episodes")
    episodes = known if matrix.episodes is None else sum(matrix.episodes)
    trainer: Trainer = cmdp.trainer
    if episodes is not None and hasattr(trainer, "eval_episodes"):
        trainer = cmdp.trainer_for(eval_episodes=episodes)
    if not isinstance(trainer, ReferenceTrainer):
        return {}
    seed = evaluation_seed(int(record.get("seed", 0)), MATRIX_TRIAL)
    rows = {}
    for name, returns in trainer.reference_rows(cmdp.space.contexts, seed).items():
        checked = checked_returns(returns, matrix.n)
        parts, counts = [checked.mean(axis=1)], matrix.episodes
        if matrix.measures_apart:
            parts, counts = halves(checked)
        if counts != matrix.episodes:
            raise InvalidInput(
                f"reference rows need the episodes of {matrix.name}, {matrix.episodes} in its "
                f"halves, got {counts}"
            )
        rows[name] = np.stack(parts)[None]
    return rows
