"""`mbtl matrix build`: a transfer matrix from real training."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from mbtl.cli.common import JsonFlag, console, print_json
from mbtl.contexts import Categorical, ContextSpace
from mbtl.errors import InvalidInput
from mbtl.problems import CMDP, cmdp_ids, get_cmdp, resolve_cmdp
from mbtl.trainers.contract import ManyTrainer
from mbtl.zoo.benchmark import TransferMatrix, levels
from mbtl.zoo.benchmark.build import ONLY
from mbtl.zoo.benchmark.kinds import GENERALIST_UNITS
from mbtl.zoo.benchmark.shipped import DEFAULT
from mbtl.zoo.cli.job import Job
from mbtl.zoo.cli.kinds import build_kinds
from mbtl.zoo.cli.shared import (
    Engine,
    Episodes,
    EvalEpisodes,
    FirstSeed,
    Out,
    Preset,
    Score,
    Timesteps,
    Visibility,
    Work,
    repeated,
)
from mbtl.zoo.cmdps.families import FAMILIES
from mbtl.zoo.cmdps.family import TwinFamily


def build(
    context: typer.Context,
    problem: Annotated[
        str,
        typer.Argument(
            metavar="CMDP", help="Id of a CMDP (`mbtl cmdps`), or module:problem of your own."
        ),
    ],
    seeds: Annotated[int, typer.Option(help="Number of matrices, one per seed.")] = 3,
    first_seed: FirstSeed = 0,
    preset: Preset = None,
    out: Out = Path("matrices"),
    variant: Annotated[
        str | None,
        typer.Option(help="Name of the set in the file names; default: from the options below."),
    ] = None,
    visibility: Visibility = None,
    physics: Annotated[
        str | None, typer.Option(help="How contexts act on CartPole: intended or reference.")
    ] = None,
    engine: Engine = None,
    score: Score = None,
    every: Annotated[
        int, typer.Option(help="Keep only every n-th context of the grid, per axis.")
    ] = 1,
    sources_every: Annotated[
        int, typer.Option(help="Train only on every n-th context; all stay targets.")
    ] = 1,
    algorithm: Annotated[str | None, typer.Option(help="Default: the preset's.")] = None,
    recipe: Annotated[
        str | None, typer.Option(help="Named hyper-parameters of the jax engine.")
    ] = None,
    timesteps: Timesteps = None,
    episodes: Episodes = None,
    eval_episodes: EvalEpisodes = None,
    checkpoint: Annotated[
        str | None,
        typer.Option(
            help="Policies to evaluate: best, final, or both (two sets from one training)."
        ),
    ] = None,
    kinds: Annotated[
        str | None,
        typer.Option(
            help="Trainings of every kind instead: specialists, generalists and tuned copies of "
            "them (some of these, with commas between, or all; tuned@1: copies of one parent). "
            "Specialists that are not asked for are those of the shipped matrix."
        ),
    ] = None,
    until: Annotated[
        float, typer.Option(help="With --kinds: units of the policies for all, at most.")
    ] = GENERALIST_UNITS[-1],
    beside: Annotated[
        list[str] | None,
        typer.Option("--with", help="With --kinds: a CMDP of the same world, trained together."),
    ] = None,
    evaluate_again: Annotated[
        bool,
        typer.Option(
            "--evaluate-again",
            help="Train nothing: evaluate the policies that this command kept before, with "
            "another --eval-episodes if you like, and replace the files.",
        ),
    ] = False,
    lanes: Annotated[
        int | None, typer.Option(help="Sources trained together in one program.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Processes; default: one per core, one on a GPU.")
    ] = None,
    work: Work = Path("runs"),
    as_json: JsonFlag = False,
) -> None:
    """Train a policy on every context, evaluate each on every context, and save the returns.

    Interrupt it at any time; the same command goes on where it was.

    Example: mbtl matrix build pendulum-length --seeds 3 --preset full

    The files are read by `mbtl bench --matrix FILE` and `mbtl matrix show FILE`.
    """
    if seeds < 1:
        raise InvalidInput(f"--seeds must be >= 1, got {seeds}")
    if beside and kinds is None:
        raise InvalidInput(
            f"--with names CMDPs that are trained together with --kinds, got {', '.join(beside)}; "
            "add --kinds all, or build one matrix after the other"
        )
    switches = {"visibility": visibility, "physics": physics, "score": score, "engine": engine}
    cmdp, *others = [
        resolve_cmdp(name, **switches)
        if every == 1
        else resolve_cmdp(name, **switches).every(every)
        for name in (problem, *(beside or ()))
    ]
    if not 1 <= sources_every <= cmdp.space.n:
        raise InvalidInput(
            f"--sources-every must be from 1 to the number of contexts ({cmdp.space.n}), got "
            f"{sources_every}"
        )
    for one in (cmdp, *others):
        _check_levels(one.space, sources_every)
    keep = _checkpoints(checkpoint)
    numbers = range(first_seed, first_seed + seeds)
    overrides = {
        "timesteps": timesteps,
        "episodes": episodes,
        "eval_episodes": eval_episodes,
        "algorithm": algorithm,
        "recipe_name": recipe,
    }
    given = {k: v for k, v in overrides.items() if v is not None}
    trainer = cmdp.trainer_for(preset, **given)
    free = ["variant", "out", "work", "workers", "evaluate_again", "as_json"]
    if kinds is not None:
        built = build_kinds(
            kinds,
            [cmdp, *others],
            [trainer, *(other.trainer_for(preset, **given) for other in others)],
            numbers,
            preset=preset or cmdp.default_preset,
            command=lambda there: repeated(context, free, kinds=there),
            every=sources_every,
            lanes=lanes,
            until=until,
            work=work,
            out=out,
        )
        if as_json:
            print_json({"transfers": built})
        return
    usual = str(getattr(trainer, "checkpoint", "final"))
    if keep:
        trainer = cmdp.trainer_for(preset, **given, checkpoint=keep[0])
    best_lanes = 1
    if isinstance(trainer, ManyTrainer):
        keep = keep or (usual,)
        best_lanes = trainer.lanes
    job = Job(
        cmdp,
        trainer,
        checkpoints=keep or (ONLY,),
        lanes=min(lanes or best_lanes, -(-cmdp.space.n // sources_every)),
        preset=preset or cmdp.default_preset,
        variant=variant or _variant(cmdp, given),
        command=repeated(context, [*free, "seeds", "first_seed"]),
        usual=usual,
        every=sources_every,
    )
    # before anything is trained
    there = {seed: {} if evaluate_again else job.there(out, seed) for seed in numbers}
    builds = {
        seed: job.again(work, seed) if evaluate_again else job.building(work, seed)
        for seed in numbers
    }
    results = []
    for seed, files in there.items():
        if files:
            names = ", ".join(map(str, files))
            console.print(f"{names}: there already", markup=False, soft_wrap=True)
        else:
            files = job.run(builds[seed], out, workers)
        results += [_shown(file, matrix) for file, matrix in files.items()]
    if as_json:
        print_json({"matrices": results})


def _shown(file: Path, matrix: TransferMatrix) -> dict[str, Any]:
    known = levels(matrix, 0)
    record = {
        "file": str(file),
        "grand_mean": known.grand_mean,
        "independent": known.independent,
        "oracle_transfer": known.oracle_transfer,
        "evaluation_seeds": matrix.evaluation_seeds,
    }
    note = f"; evaluation seeds {matrix.evaluation_seeds}"
    note += "" if matrix.caveat is None else f"; {matrix.caveat}"
    console.print(
        f"{file}: random policy {known.grand_mean:.4f}, Independent {known.independent:.4f}, "
        f"Oracle Transfer {known.oracle_transfer:.4f}{note}",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )
    return record


def _lost(space: ContextSpace, every: int) -> str | None:
    """A level of a categorical axis that none of the sources has."""
    for axis in space.axes:
        values = space.values(axis.name)
        if isinstance(axis, Categorical) and (lost := set(values) - set(values[::every])):
            return f"{axis.name} = {min(lost)}"
    return None


def _check_levels(space: ContextSpace, every: int) -> None:
    """Refuse sources that lose a level: no other one stands for it."""
    if lost := _lost(space, every):
        fits = max(n for n in range(1, every) if not _lost(space, n))
        raise InvalidInput(
            "--sources-every must keep a context of every level of a categorical axis, got "
            f"{every}, which keeps none of {lost}; take {fits}"
        )


def _checkpoints(checkpoint: str | None) -> tuple[str, ...]:
    choices = {None: (), "best": ("best",), "final": ("final",), "both": ("best", "final")}
    if checkpoint not in choices:
        raise InvalidInput(f"--checkpoint is best, final or both, got {checkpoint!r}")
    return choices[checkpoint]


def _variant(cmdp: CMDP, given: Mapping[str, Any]) -> str:
    """Name of the set: what differs from the CMDP as it is by default."""
    parts = []
    usual = _usual(cmdp)
    for switch in ("visibility", "engine", "score"):
        now = cmdp.settings.get(switch)
        if usual.get(switch, now) != now:
            parts.append(str(now))
    if cmdp.settings.get("physics", "intended") != "intended":
        parts.append(str(cmdp.settings["physics"]))
    if "every" in cmdp.settings:
        parts.append(f"every{cmdp.settings['every']}")
    if "algorithm" in given:
        parts.append(str(given["algorithm"]).lower())
    return "-".join(parts) or DEFAULT


def _usual(cmdp: CMDP) -> Mapping[str, Any]:
    """Switches of one of our CMDPs unless told otherwise; a user's own has none."""
    if cmdp.id not in cmdp_ids() or not set(cmdp.settings) - {"every"}:
        return {}
    usual = dict(get_cmdp(cmdp.id).settings)
    if not isinstance(FAMILIES[cmdp.family].jax, TwinFamily):
        del usual["engine"]  # both engines have the same physics
    return usual
