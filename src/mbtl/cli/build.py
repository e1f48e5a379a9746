"""`mbtl matrix build`: a transfer matrix from real training."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mbtl.benchmark import TransferMatrix, levels, save_shipped
from mbtl.benchmark.build import ONLY, Build
from mbtl.benchmark.shipped import DEFAULT, matrix_id, shipped_file
from mbtl.cli.common import JsonFlag, LongWork, console, print_json
from mbtl.cmdps import CMDP, cmdp_ids, get_cmdp, resolve_cmdp
from mbtl.cmdps.families import FAMILIES
from mbtl.cmdps.family import TwinFamily
from mbtl.errors import InvalidInput
from mbtl.files import is_claimed_for
from mbtl.processes import usable_cores
from mbtl.provenance import check_made_by
from mbtl.trainer import ManyTrainer, Trainer, recipe_of


def build(
    problem: Annotated[
        str,
        typer.Argument(
            metavar="CMDP", help="Id of a CMDP (`mbtl cmdps`), or module:problem of your own."
        ),
    ],
    seeds: Annotated[int, typer.Option(help="Number of matrices, one per seed.")] = 3,
    first_seed: Annotated[int, typer.Option(help="Seed of the first matrix.")] = 0,
    preset: Annotated[
        str | None,
        typer.Option("--preset", "--tier", help="Training recipe; `mbtl cmdps CMDP` lists them."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the finished files.")] = Path("matrices"),
    variant: Annotated[
        str | None,
        typer.Option(help="Name of the set in the file names; default: from the options below."),
    ] = None,
    visibility: Annotated[
        str | None, typer.Option(help="What of the context the policy sees.")
    ] = None,
    physics: Annotated[str, typer.Option(help="How contexts act on CartPole.")] = "intended",
    engine: Annotated[str | None, typer.Option(help="jax, gymnasium or sumo.")] = None,
    every: Annotated[
        int, typer.Option(help="Only each so many-th context of the grid, per axis.")
    ] = 1,
    algorithm: Annotated[str | None, typer.Option(help="Default: the preset's.")] = None,
    recipe: Annotated[
        str | None, typer.Option(help="Named hyper-parameters of the jax engine.")
    ] = None,
    timesteps: Annotated[int | None, typer.Option(help="Environment steps per training.")] = None,
    episodes: Annotated[
        int | None, typer.Option(help="Episodes per training, where those are counted.")
    ] = None,
    eval_episodes: Annotated[
        int | None, typer.Option(help="Episodes per policy and context.")
    ] = None,
    checkpoint: Annotated[
        str | None,
        typer.Option(
            help="Policies to evaluate: best, final, or both (two sets from one training)."
        ),
    ] = None,
    lanes: Annotated[
        int | None, typer.Option(help="Sources trained together in one program.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Processes; default: one per core, one on a GPU.")
    ] = None,
    work: Annotated[Path, typer.Option(help="Folder of unfinished matrices.")] = Path("runs"),
    as_json: JsonFlag = False,
) -> None:
    """Train a policy on every context, evaluate each on every context, and save the returns.

    Interrupt it at any time; the same command goes on where it was.

    Example: mbtl matrix build pendulum-length --seeds 3 --preset full

    The files are read by `mbtl bench --matrix FILE` and `mbtl matrix show FILE`.
    """
    if seeds < 1:
        raise InvalidInput(f"--seeds must be >= 1, got {seeds}")
    cmdp = resolve_cmdp(problem, visibility=visibility, physics=physics, engine=engine)
    if every != 1:
        cmdp = cmdp.every(every)
    keep = _checkpoints(checkpoint)
    overrides = {
        "timesteps": timesteps,
        "episodes": episodes,
        "eval_episodes": eval_episodes,
        "algorithm": algorithm,
        "recipe_name": recipe,
        "checkpoint": keep[0] if keep else None,
    }
    given = {k: v for k, v in overrides.items() if v is not None}
    trainer = cmdp.trainer_for(preset, **given)
    best_lanes = 1
    if isinstance(trainer, ManyTrainer):
        keep = keep or (str(getattr(trainer, "checkpoint", "final")),)
        best_lanes = trainer.lanes
    job = _Job(
        cmdp,
        trainer,
        checkpoints=keep or (ONLY,),
        lanes=min(lanes or best_lanes, cmdp.space.n),
        preset=preset or cmdp.default_preset,
        variant=variant or _variant(cmdp, given),
        command=_command(
            problem,
            {
                "preset": preset,
                "visibility": visibility,
                "physics": None if physics == "intended" else physics,
                "engine": engine,
                "every": None if every == 1 else every,
                "lanes": lanes,
                "timesteps": timesteps,
                "episodes": episodes,
                "eval-episodes": eval_episodes,
                "algorithm": algorithm,
                "recipe": recipe,
                "checkpoint": checkpoint,
            },
        ),
    )
    there = {  # before anything is trained
        seed: job.there(out, seed) for seed in range(first_seed, first_seed + seeds)
    }
    results = []
    for seed, files in there.items():
        if files:
            console.print(f"{', '.join(map(str, files))}: there already", markup=False)
        else:
            files = job.run(seed, out, work, workers)
        results += [_shown(file, matrix) for file, matrix in files.items()]
    if as_json:
        print_json({"matrices": results})


@dataclass(frozen=True)
class _Job:
    """What is built, for any seed.

    Attributes:
        cmdp: the problem.
        trainer: of its policies.
        checkpoints: policies of a training that are evaluated, each into a file of its own.
        lanes: sources trained together.
        preset: for the record.
        variant: name of the set.
        command: that builds it, but for the seed.
    """

    cmdp: CMDP
    trainer: Trainer
    checkpoints: tuple[str, ...]
    lanes: int
    preset: str
    variant: str
    command: str

    @property
    def settings(self) -> dict[str, Any]:
        """JSON-able; all that the numbers depend on."""
        return {
            "problem": self.cmdp.id,
            "version": self.cmdp.version,
            "switches": dict(self.cmdp.settings),
            "recipe": recipe_of(self.trainer),
        }

    def of_checkpoint(self, checkpoint: str) -> dict[str, Any]:
        """`settings` of one of several."""
        settings = self.settings
        if checkpoint != ONLY:
            settings["recipe"] = {**settings["recipe"], "checkpoint": checkpoint}
        return settings

    def file(self, out: Path, checkpoint: str, seed: int) -> Path:
        """Where it is to be saved."""
        return shipped_file(out, self.cmdp.id, _name(self.variant, checkpoint), seed)

    def there(self, out: Path, seed: int) -> dict[Path, TransferMatrix]:
        """The finished files of a seed; empty unless all are there.

        Raises:
            InvalidInput: one was made with other settings.
        """
        found = {}
        for checkpoint in self.checkpoints:
            file = self.file(out, checkpoint, seed)
            if file.is_file():
                found[file] = TransferMatrix.load(file)
                self._check(file, found[file].provenance, checkpoint)
        return found if len(found) == len(self.checkpoints) else {}

    def _check(self, file: Path, record: Mapping[str, Any], checkpoint: str) -> None:
        try:
            check_made_by(file, record, self.of_checkpoint(checkpoint))
        except InvalidInput as error:
            for name, preset in self.cmdp.presets.items():
                if preset.formerly == record.get("preset") == self.preset:
                    raise InvalidInput(f"{error} (its preset is called {name!r} now)") from error
            raise

    def run(
        self, seed: int, out: Path, work: Path, workers: int | None
    ) -> dict[Path, TransferMatrix]:
        """Train and evaluate what is missing, and write the files of a seed."""
        name = matrix_id(self.cmdp.id, self.variant)
        building = self._building(work, name, seed)
        if workers is None:
            workers = 1 if self.lanes >= self.cmdp.space.n else usable_cores()
        _run(building, workers, f"{name} seed {seed}")
        built = {}
        for checkpoint in self.checkpoints:
            file = self.file(out, checkpoint, seed)
            built[file] = TransferMatrix.of_episodes(
                building.returns(checkpoint)[None],
                space=self.cmdp.space,
                bounds=self.cmdp.bounds,
                theta=self.cmdp.theta,
                direction="max" if self.cmdp.direction == "maximize" else "min",
                provenance={
                    **self.of_checkpoint(checkpoint),
                    "preset": self.preset,
                    "seed": seed,
                    "lanes": self.lanes,
                    "command": f"{self.command} --seeds 1 --first-seed {seed}",
                    "process_seconds": round(building.seconds(), 1),
                    "train_seconds": round(building.seconds("train_seconds"), 1),
                    "nominal": None if self.cmdp.nominal is None else dict(self.cmdp.nominal),
                    "origins": building.origins(),
                },
                name=file.name,
            )
            variant = _name(self.variant, checkpoint)
            save_shipped(built[file], out, self.cmdp.id, variant, first_seed=seed)
        return built

    def _building(self, work: Path, name: str, seed: int) -> Build:
        """In the folder of the preset's name, or of its former one if it was begun there."""
        now, before = self.preset, self.cmdp.preset(self.preset).formerly
        builds = [
            Build(
                self.trainer,
                self.cmdp.space,
                seed,
                work / f"matrix-{name}-{preset}-seed{seed}",
                self.settings,
                self.checkpoints,
                self.lanes,
            )
            for preset in (now, before)
        ]
        return next((one for one in builds if is_claimed_for(one.folder, one.claim)), builds[0])


def _run(building: Build, workers: int, label: str) -> None:
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(label, total=building.space.n)
        log = LongWork(console)

        def on_piece(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)
            log.say(f"{label}: {done} of {total} sources")

        building.run(workers, on_piece)


def _shown(file: Path, matrix: TransferMatrix) -> dict[str, Any]:
    known = levels(matrix, 0)
    record = {
        "file": str(file),
        "grand_mean": known.grand_mean,
        "independent": known.independent,
        "oracle_transfer": known.oracle_transfer,
    }
    console.print(
        f"{file}: one policy {known.grand_mean:.4f}, Independent {known.independent:.4f}, "
        f"Oracle Transfer {known.oracle_transfer:.4f}",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )
    return record


def _checkpoints(checkpoint: str | None) -> tuple[str, ...]:
    choices = {None: (), "best": ("best",), "final": ("final",), "both": ("best", "final")}
    if checkpoint not in choices:
        raise InvalidInput(f"--checkpoint is best, final or both, got {checkpoint!r}")
    return choices[checkpoint]


def _variant(cmdp: CMDP, given: Mapping[str, Any]) -> str:
    """Name of the set: what differs from the CMDP as it is by default."""
    parts = []
    usual = _usual(cmdp)
    for switch in ("visibility", "engine"):
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


def _name(variant: str, checkpoint: str) -> str:
    """Variant of a checkpoint: "final" is named where it stands beside, or instead of, best."""
    if checkpoint != "final":
        return variant
    return "final" if variant == DEFAULT else f"{variant}-final"


def _command(problem: str, options: Mapping[str, Any]) -> str:
    """The command that builds the same again; folders and processes do not matter to it."""
    words = ["mbtl", "matrix", "build", problem]
    for name, value in options.items():
        if value is not None:
            words += [f"--{name}", str(value)]
    return shlex.join(words)
