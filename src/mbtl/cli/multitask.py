"""`mbtl matrix multitask`: baselines that train one policy on all contexts."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from mbtl.arrays import Array
from mbtl.benchmark.multitask import multitask_file, read_multitask, save_multitask
from mbtl.benchmark.provenance import here
from mbtl.cli.common import JsonFlag, LongWork, console, print_json
from mbtl.cmdps import CMDP, get_cmdp
from mbtl.errors import InvalidInput, unknown_name
from mbtl.files import claim_folder, whole_file
from mbtl.seeds import MATRIX_TRIAL, evaluation_seed, training_seed
from mbtl.trainer import Progress as Training
from mbtl.training import JaxTrainer, SB3Trainer, TwinTrainer

Method = Literal["ppo", "paco", "moore"]
_TOGETHER = 10
"""Contexts evaluated at once in a simulator, between two signs of life."""


def multitask(
    cmdp_id: Annotated[str, typer.Argument(metavar="CMDP", help="Id of one of our CMDPs.")],
    method: Annotated[
        str | None,
        typer.Option(
            help="ppo (context-conditioned), paco or moore; in traffic, and by default, the "
            "algorithm of the CMDP."
        ),
    ] = None,
    factor: Annotated[
        int,
        typer.Option(
            help="Length of the training, as a multiple of one source's; in a twin, episodes of "
            "each of as many updates."
        ),
    ] = 1,
    seeds: Annotated[int, typer.Option(help="Number of policies, one per seed.")] = 3,
    first_seed: Annotated[int, typer.Option(help="Seed of the first.")] = 0,
    preset: Annotated[
        str,
        typer.Option(help="Recipe of one source."),
    ] = "paper",
    engine: Annotated[
        str | None,
        typer.Option(help="jax, gymnasium or sumo; default: that of the CMDP.", show_default=False),
    ] = None,
    timesteps: Annotated[
        int | None, typer.Option(help="Environment steps of one source; default: the preset's.")
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(help="Episodes of one source, where those are counted.")
    ] = None,
    eval_episodes: Annotated[
        int | None, typer.Option(help="Episodes per context; default: the preset's.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the finished files.")] = Path(
        "matrices/multitask"
    ),
    work: Annotated[Path, typer.Option(help="Folder of unfinished ones.")] = Path("runs"),
    as_json: JsonFlag = False,
) -> None:
    """Train one policy on all contexts, evaluate it on each, and save the returns.

    Interrupt it at any time; the same command goes on where it was.

    Example: mbtl matrix multitask cartpole-length --method paco --seeds 3
    """
    counts = {"seeds": seeds, "factor": factor, "timesteps": timesteps, "episodes": episodes,
              "eval-episodes": eval_episodes}  # fmt: skip
    for name, number in counts.items():
        if number is not None and number < 1:
            raise InvalidInput(f"--{name} must be >= 1, got {number}")
    cmdp = get_cmdp(cmdp_id, visibility="multiplier", engine=engine)
    job = _job(cmdp, method, factor, preset, timesteps, episodes, eval_episodes, work)
    if engine == get_cmdp(cmdp_id).settings["engine"]:
        engine = None
    given = {"method": method, "factor": factor if factor > 1 else None,
             "preset": preset if preset != "paper" else None, "engine": engine,
             "timesteps": timesteps, "episodes": episodes,
             "eval-episodes": eval_episodes}  # fmt: skip
    words = [f"--{name} {value}" for name, value in given.items() if value is not None]
    command = " ".join(["mbtl matrix multitask", cmdp_id, *words, "--seeds 1 --first-seed"])
    files = {
        seed: multitask_file(out, job.cmdp.id, job.name, seed)
        for seed in range(first_seed, first_seed + seeds)
    }
    there = {seed for seed, file in files.items() if file.is_file()}
    for seed in there:  # before anything is trained
        _check_made_by(files[seed], f"{command} {seed}", cmdp)
    results = []
    for seed, file in files.items():
        if seed in there:
            console.print(f"{file}: there already", markup=False)
        else:
            _one(job, seed, f"{command} {seed}", out)
        results.append(_shown(job.cmdp, file))
    if as_json:
        print_json({"baselines": results})


OnStep = Callable[[int, int, str], None]
"""Called with (done, total, a note)."""

Found = tuple[Array, Array, dict[str, Any]]
"""(N,) mean returns and (N,) standard deviations over episodes, and their provenance."""


@dataclass(frozen=True)
class _InJax:
    """Vectorised: PPO, PaCo or MOORE."""

    cmdp: CMDP
    method: Method
    name: str
    length: int
    eval_episodes: int
    work: Path

    def run(self, seed: int, on_step: OnStep) -> Found:
        import mbtl.training.jax as engine

        assert isinstance(self.cmdp.trainer, JaxTrainer)
        env, params = self.cmdp.trainer.problem(self.cmdp.space.contexts)
        run = engine.run_multitask(
            env,
            engine.multitask_recipe(self.method, type(env).__name__),
            params,
            [seed],
            self.length,
            self.work / f"multitask-{self.cmdp.id}-{self.name}-seed{seed}",
            episodes=self.eval_episodes,
            on_progress=lambda _, done, total, value: on_step(done, total, f"return {value:.0f}"),
        )
        record = {"checkpoint": "best", "final_mean_return": float(run.returns["final"].mean())}
        return run.returns["best"][0], run.std["best"][0], {**run.provenance[0], **record}


@dataclass(frozen=True)
class _InSimulator:
    """By Stable-Baselines3, or in a twin."""

    cmdp: CMDP
    trainer: SB3Trainer | TwinTrainer
    name: str
    work: Path

    @property
    def length(self) -> int:
        return self.trainer.episodes or getattr(self.trainer, "timesteps", None) or 0

    def run(self, seed: int, on_step: OnStep) -> Found:
        from mbtl.training.multitask import recipe_on_all

        space = self.cmdp.space
        chosen = training_seed(seed, MATRIX_TRIAL, space.n)  # that of the source after the last
        recipe = recipe_on_all(self.trainer)
        policy, trained = self._policy(recipe, seed, chosen, on_step)
        rows, play = [], evaluation_seed(seed, MATRIX_TRIAL)
        for first in range(0, space.n, _TOGETHER):
            on_step(self.length, self.length, f"evaluated on {first} of {space.n} contexts")
            contexts = space.contexts[first : first + _TOGETHER]
            rows.append(self.trainer.evaluate(policy, contexts, play))
        returns = np.concatenate(rows)
        record = {
            "recipe": recipe,
            "seed": seed,
            "training_seed": chosen,
            "training": trained,
        }
        return returns.mean(axis=1), returns.std(axis=1), record

    def _policy(
        self, recipe: dict[str, Any], seed: int, chosen: int, on_step: OnStep
    ) -> tuple[Any, dict[str, Any]]:
        """Trained now or by an interrupted run, and by which code and how long that was."""
        from mbtl.training.multitask import train_on_all

        cmdp = self.cmdp
        folder = self.work / f"multitask-{cmdp.id}-{self.name}-seed{seed}"
        decides = {"version": cmdp.version, "switches": dict(cmdp.settings), "seed": seed, **recipe}
        del decides["eval_episodes"]  # more of them need no other policy
        claim_folder(folder, decides, "a multi-task policy")
        done = folder / "trained.json"
        if done.is_file():
            return self.trainer.load(folder / "policy"), json.loads(done.read_text("utf-8"))

        def on_progress(progress: Training) -> None:
            note = " ".join(f"{k} {v:.2f}" for k, v in progress.metrics.items())
            on_step(progress.step, progress.total, note)

        begin, origin = time.process_time(), here()
        partial = folder / "training.npz"
        policy = train_on_all(
            self.trainer,
            cmdp.space.contexts,
            chosen,
            on_progress,
            partial=partial,
        )
        trained = {"train_seconds_of_last_run": round(time.process_time() - begin, 1), **origin}
        (folder / "policy").mkdir(exist_ok=True)
        self.trainer.save(policy, folder / "policy")
        with whole_file(done) as file:
            file.write(json.dumps(trained).encode())
        partial.unlink(missing_ok=True)
        return policy, trained


def _job(
    cmdp: CMDP,
    method: str | None,
    factor: int,
    preset: str,
    timesteps: int | None,
    episodes: int | None,
    eval_episodes: int | None,
    work: Path,
) -> _InJax | _InSimulator:
    suffix = "" if factor == 1 else f"-x{factor}"
    if isinstance(cmdp.trainer, JaxTrainer):
        known: tuple[Method, ...] = get_args(Method)
        if method is not None and method not in known:
            raise unknown_name("method", method, known)
        if episodes is not None:
            raise InvalidInput(f"{cmdp.id!r} counts steps, got --episodes; use --timesteps")
        steps = (cmdp.preset(preset).timesteps or 0) if timesteps is None else timesteps
        chosen = method or "ppo"
        return _InJax(cmdp, chosen, chosen + suffix, steps * factor, eval_episodes or 100, work)
    trainer = cmdp.trainer_for(preset)
    assert isinstance(trainer, SB3Trainer | TwinTrainer)
    own = str(trainer.algorithm).lower()
    if method not in (None, own):
        raise unknown_name(f"method for {cmdp.id!r}", method, [own])
    unit, wanted, unused = "episodes", episodes, timesteps
    if getattr(trainer, "timesteps", None) is not None:
        unit, wanted, unused = "timesteps", timesteps, episodes
    if unused is not None:
        got = "--timesteps" if unit == "episodes" else "--episodes"
        raise InvalidInput(f"{cmdp.id!r} counts {unit}, got {got}; use --{unit}")
    changes: dict[str, Any] = {"eval_episodes": eval_episodes} if eval_episodes else {}
    if isinstance(trainer, TwinTrainer):  # as many updates as one source has, each of more episodes
        own_changes = trainer.hyperparameters
        each = factor * own_changes.get("n_episodes", 1)
        changes["hyperparameters"] = {**own_changes, "n_episodes": each}
    changes[unit] = (wanted or getattr(trainer, unit)) * factor
    return _InSimulator(cmdp, replace(trainer, **changes), own + suffix, work)


def _one(job: _InJax | _InSimulator, seed: int, command: str, out: Path) -> None:
    cmdp = job.cmdp
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=30),
        TextColumn("{task.fields[note]}", markup=False),
        TimeRemainingColumn(),
    )
    begin, origin = time.perf_counter(), here()  # of the code that runs, not of later commits
    with Progress(*columns, console=console, transient=True) as bar:
        label, log = f"{cmdp.id} {job.name} seed {seed}", LongWork(console)
        task = bar.add_task(label, total=job.length, note="")

        def on_step(done: int, total: int, note: str) -> None:
            bar.update(task, completed=done, total=total, note=note)
            log.say(f"{label}: {done:,} of {total:,}  {note}")

        returns, std, record = job.run(seed, on_step)
    provenance = {
        **origin,
        **record,
        "problem": cmdp.id,
        "switches": dict(cmdp.settings),
        "command": command,
        "wall_seconds_of_last_run": round(time.perf_counter() - begin, 1),
    }
    save_multitask(returns, std, provenance, out, cmdp.id, job.name, seed)


def _check_made_by(file: Path, command: str, cmdp: CMDP) -> None:
    """Options are not in the name of a file: another command's must not pass for this one's."""
    record = read_multitask(file).provenance[0]
    place, here_now = record["switches"]["engine"], cmdp.settings["engine"]
    if (record["command"], place) != (command, here_now):
        raise InvalidInput(
            f"{file} was made by {record['command']!r} in {place}, got {command!r} in {here_now}; "
            "choose another --out, or remove it"
        )


def _shown(cmdp: CMDP, file: Path) -> dict[str, Any]:
    assert cmdp.normalisation is not None
    value = float(cmdp.normalisation.normalise(read_multitask(file).returns).mean())
    console.print(f"{file}: V = {value:.4f}", markup=False, highlight=False, soft_wrap=True)
    return {"file": str(file), "performance": value}
