"""`mbtl matrix build --kinds`: transfer data of trainings of every kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    command: Callable[[str], str],
    every: int,
    lanes: int | None,
    until: float,
    work: Path,
    out: Path,
) -> list[dict[str, Any]]:
    """Build what is missing, and write the file of each CMDP and seed, of all that is there.

    Args:
        kinds: names of kinds, with commas between; or "all".
        cmdps: the problems, of one world and recipe.
        trainers: theirs.
        seeds: of the matrices.
        preset: of the recipe.
        command: kinds -> the command that builds the same again.
        every: sources are every n-th context.
        lanes: trainings of one program; None: what is best here.
        until: units of the policies for all, at most.
        work: folder of what is not finished.
        out: folder of the finished files.

    Raises:
        InvalidInput: a trainer does not train many policies at once, the problems differ, or the
            policies for all, or specialists, are not there yet.
        UnknownName: no such kind.
    """
    wanted = KINDS if kinds == ALL else tuple(kinds.split(","))
    for cmdp, trainer in zip(cmdps, trainers, strict=True):
        if not isinstance(trainer, WorldTrainer):
            ours = "engine" in cmdp.settings
            way = "choose --engine jax" if ours else "make it one (mbtl.engine.jax_problem)"
            raise InvalidInput(
                f"trainings of every kind need a problem in jax, got {cmdp.id!r}, which "
                f"{type(trainer).__name__} trains; {way}, or leave --kinds out, for specialists"
            )
    names = [cmdp.id for cmdp in cmdps]
    folder = work / FOLDER / "-and-".join(names)
    build = Kinds(
        tuple(cmdps), tuple(trainers), tuple(seeds), folder, every=every, lanes=lanes, until=until
    )
    with bar(", ".join(names)) as tell:

        def on_progress(part: str, progress: Progress | None) -> None:
            step, total = (0, None) if progress is None else (progress.step, progress.total)
            tell(step, total, part)

        build.run(wanted, on_progress)
    there = list(dict.fromkeys(part.asked for part in build.there()))
    if "specialists" in there:  # a matrix has such rows, too
        build.refer()
    files = build.save(out / FOLDER, command(",".join(there)), preset)
    for file in files:
        console.print(f"{file}: {', '.join(there)}", markup=False, soft_wrap=True)
    return [{"file": str(file), "kinds": there} for file in files]
