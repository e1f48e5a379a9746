"""`mbtl matrix multitask`: baselines that train one policy on all contexts."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, get_args

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from mbtl.cli.common import JsonFlag, LongWork, console, print_json
from mbtl.engine import WorldTrainer
from mbtl.errors import InvalidInput, unknown_name
from mbtl.problems import CMDP, get_cmdp
from mbtl.provenance import check_made_by, here
from mbtl.seeds import seeds_in
from mbtl.trainers import SB3Trainer
from mbtl.zoo.benchmark.multitask import (
    InJax,
    InSimulator,
    Method,
    multitask_file,
    read_multitask,
    save_multitask,
    train_on_all,
)
from mbtl.zoo.cmdps.registry import preset_on_all, visibility_on_all


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
        str | None,
        typer.Option(
            help="Recipe of one source; default: paper, of walkers and cheetahs standard.",
            show_default=False,
        ),
    ] = None,
    engine: Annotated[
        str | None,
        typer.Option(help="jax, gymnasium or sumo; default: that of the CMDP.", show_default=False),
    ] = None,
    score: Annotated[
        str | None,
        typer.Option(help="What an episode of traffic is worth: paper, or the CMDP's own."),
    ] = None,
    visibility: Annotated[
        str | None,
        typer.Option(
            help="What of the context the policy sees; default: the multiplier, and nothing of a "
            "hold.",
            show_default=False,
        ),
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
    usual = visibility_on_all(cmdp_id)
    other = None if visibility in (None, usual) else visibility
    cmdp = get_cmdp(cmdp_id, visibility=visibility or usual, engine=engine, score=score)
    usual_preset = preset_on_all(cmdp_id)
    job = _job(cmdp, method, factor, preset or usual_preset, timesteps, episodes, eval_episodes)
    if engine == get_cmdp(cmdp_id).settings["engine"]:
        engine = None
    given = {"method": method, "factor": factor if factor > 1 else None,
             "preset": None if preset == usual_preset else preset, "engine": engine,
             "score": score, "visibility": other, "timesteps": timesteps, "episodes": episodes,
             "eval-episodes": eval_episodes}  # fmt: skip
    words = [f"--{name} {value}" for name, value in given.items() if value is not None]
    command = " ".join(["mbtl matrix multitask", cmdp_id, *words, "--seeds 1 --first-seed"])
    name = "-".join(filter(None, (job.method, other, score, f"x{factor}" if factor > 1 else None)))
    files = {
        seed: multitask_file(out, cmdp.id, name, seed)
        for seed in range(first_seed, first_seed + seeds)
    }
    there = {seed for seed, file in files.items() if file.is_file()}
    chosen = _problem(cmdp)
    settings = {**chosen, **job.settings}
    for seed in there:  # before anything is trained
        check_made_by(files[seed], read_multitask(files[seed]).provenance[0], settings)
    results = []
    for seed, file in files.items():
        if seed in there:
            console.print(f"{file}: there already", markup=False)
        else:
            _one(cmdp.id, job, name, seed, {**chosen, "command": f"{command} {seed}"}, out, work)
        results.append(_shown(cmdp, file))
    if as_json:
        print_json({"baselines": results})


def _job(
    cmdp: CMDP,
    method: str | None,
    factor: int,
    preset: str,
    timesteps: int | None,
    episodes: int | None,
    eval_episodes: int | None,
) -> InJax | InSimulator:
    if isinstance(cmdp.trainer, WorldTrainer) and cmdp.trainer.unit == "timesteps":
        known: tuple[Method, ...] = get_args(Method)
        if method is not None and method not in known:
            raise unknown_name("method", method, known)
        if episodes is not None:
            raise InvalidInput(f"{cmdp.id!r} counts steps, got --episodes; use --timesteps")
        steps = (cmdp.preset(preset).timesteps or 0) if timesteps is None else timesteps
        one = cmdp.trainer_for(preset)
        assert isinstance(one, WorldTrainer)
        return InJax(
            one,
            cmdp.space.contexts,
            method or "ppo",
            steps * factor,
            eval_episodes,
        )
    trainer = cmdp.trainer_for(preset)
    assert isinstance(trainer, SB3Trainer | WorldTrainer)
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
    if isinstance(
        trainer, WorldTrainer
    ):  # as many updates as one source has, each of more episodes
        own_changes = trainer.hyperparameters
        each = factor * own_changes.get("n_episodes", 1)
        changes["hyperparameters"] = {**own_changes, "n_episodes": each}
    changes[unit] = (wanted or getattr(trainer, unit)) * factor
    return InSimulator(replace(trainer, **changes), cmdp.space.contexts, _problem(cmdp))


def _problem(cmdp: CMDP) -> dict[str, Any]:
    """What decides a policy beside its training; JSON-able."""
    return {"version": cmdp.version, "switches": dict(cmdp.settings)}


def _one(
    cmdp: str,
    job: InJax | InSimulator,
    name: str,
    seed: int,
    chosen: dict[str, Any],
    out: Path,
    work: Path,
) -> None:
    """One seed: train, evaluate, write its file; `chosen` goes into its provenance."""
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=30),
        TextColumn("{task.fields[note]}", markup=False),
        TimeRemainingColumn(),
    )
    begin, code = time.perf_counter(), here()  # of the code that runs, not of later commits
    with Progress(*columns, console=console, transient=True) as bar:
        label, log = f"{cmdp} {name} seed {seed}", LongWork(console)
        task = bar.add_task(label, total=job.length, note="")

        def on_step(done: int, total: int, note: str) -> None:
            bar.update(task, completed=done, total=total, note=note)
            log.say(f"{label}: {done:,} of {total:,}  {note}")

        folder = work / f"multitask-{cmdp}-{name}-seed{seed}"
        returns, std, record = train_on_all(job, seed, folder, on_step)
    provenance = {
        **code,
        **record,
        **chosen,
        "problem": cmdp,
        "wall_seconds_of_last_run": round(time.perf_counter() - begin, 1),
    }
    save_multitask(returns, std, provenance, out, cmdp, name, seed)


def _shown(cmdp: CMDP, file: Path) -> dict[str, Any]:
    assert cmdp.normalisation is not None
    found = read_multitask(file)
    value = float(cmdp.normalisation.normalise(found.returns).mean())
    seeds = seeds_in(found.provenance) or "not known"
    said = f"{file}: V = {value:.4f}; evaluation seeds {seeds}"
    console.print(said, markup=False, highlight=False, soft_wrap=True)
    return {"file": str(file), "performance": value, "evaluation_seeds": seeds}
