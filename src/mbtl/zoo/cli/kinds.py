"""`mbtl matrix build --kinds`: transfer data of trainings of every kind."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mbtl.cli.common import console
from mbtl.engine.world_trainer import WorldTrainer
from mbtl.errors import InvalidInput
from mbtl.problems import CMDP
from mbtl.trainers.contract import Progress
from mbtl.zoo.benchmark.kinds import Kinds
from mbtl.zoo.benchmark.transfers import FOLDER, KINDS
from mbtl.zoo.cli.shared import bar

ALL = "all"


def build_kinds(
    kinds: str,
    cmdps: Sequence[CMDP],
    trainers: Sequence[Any],
    seeds: Sequence[int],
    *,
    preset: str,
    command: str,
    every: int,
    lanes: int | None,
    work: Path,
    out: Path,
) -> list[dict[str, Any]]:
    """Build what is missing and, once every kind is there, write the file of each CMDP and seed.

    Args:
        kinds: names of kinds, with commas between; or "all".
        cmdps: the problems, of one world and recipe.
        trainers: theirs.
        seeds: of the matrices.
        preset: of the recipe.
        command: that builds the same, all kinds and seeds, again.
        every: sources are every n-th context.
        lanes: trainings of one program; None: what is best here.
        work: folder of what is not finished.
        out: folder of the finished files.

    Raises:
        InvalidInput: a trainer does not train many policies at once, or the problems differ.
        UnknownName: no such kind.
    """
    wanted = KINDS if kinds == ALL else tuple(kinds.split(","))
    own = [trainer for trainer in trainers if isinstance(trainer, WorldTrainer)]
    if len(own) < len(cmdps):
        raise InvalidInput(
            "trainings of every kind are built by the jax engine, got a trainer that is "
            f"{type(trainers[len(own)]).__name__}; choose --engine jax, or leave --kinds out"
        )
    names = [cmdp.id for cmdp in cmdps]
    folder = work / FOLDER / "-and-".join(names)
    build = Kinds(tuple(cmdps), tuple(own), tuple(seeds), folder, every=every, lanes=lanes)
    with bar(", ".join(names)) as tell:

        def on_progress(part: str, progress: Progress | None) -> None:
            step, total = (0, None) if progress is None else (progress.step, progress.total)
            tell(step, total, part)

        build.run(wanted, on_progress)
    if left := [kind for kind in KINDS if not build.is_there(kind)]:
        console.print(
            f"kept in {folder}; the files are written once {' and '.join(left)} are there, too",
            markup=False,
            soft_wrap=True,
        )
        return []
    build.refer()
    files = build.save(out / FOLDER, command, preset)
    for file in files:
        console.print(f"{file}: all kinds", markup=False, soft_wrap=True)
    return [{"file": str(file), "kinds": list(KINDS)} for file in files]
