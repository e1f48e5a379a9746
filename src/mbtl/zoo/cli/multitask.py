"""`mbtl matrix multitask`: baselines that train one policy on all contexts."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from mbtl.cli.common import JsonFlag, console, print_json
from mbtl.engine import WorldTrainer
from mbtl.errors import InvalidInput, unknown_name
from mbtl.problems import CMDP, get_cmdp
from mbtl.seeds import seeds_in
from mbtl.trainers import SB3Trainer
from mbtl.trainers.contract import Trainer
from mbtl.zoo.benchmark.multitask import (
    InJax,
    InSimulator,
    Method,
    multitask_file,
    read_multitask,
    save_multitask,
    train_on_all,
)
from mbtl.zoo.benchmark.provenance import check_made_by, here
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
    bar,
    repeated,
)
from mbtl.zoo.cmdps.registry import preset_on_all, visibility_on_all


def multitask(
    context: typer.Context,
    cmdp_id: Annotated[str, typer.Argument(metavar="CMDP", help="Id of one of our CMDPs.")],
    method: Annotated[
        str | None,
        typer.Option(
            help="ppo (context-conditioned), paco or moore; in traffic, and by default, the "
            "algorithm of the CMDP."
        ),
    ] = None,
    seeds: Annotated[int, typer.Option(help="Number of policies, one per seed.")] = 3,
    first_seed: FirstSeed = 0,
    preset: Preset = None,
    engine: Engine = None,
    score: Score = None,
    visibility: Visibility = None,
    timesteps: Timesteps = None,
    episodes: Episodes = None,
    eval_episodes: EvalEpisodes = None,
    out: Out = Path("matrices/multitask"),
    work: Work = Path("runs"),
    as_json: JsonFlag = False,
) -> None:
    """Train one policy on all contexts, evaluate it on each, and save the returns.

    Interrupt it at any time; the same command goes on where it was.

    Example: mbtl matrix multitask cartpole-length --method paco --seeds 3
    """
    if seeds < 1:
        raise InvalidInput(f"--seeds must be >= 1, got {seeds}")
    usual = visibility_on_all(cmdp_id)
    other = None if visibility in (None, usual) else visibility
    cmdp = get_cmdp(cmdp_id, visibility=visibility or usual, engine=engine, score=score)
    own = {"timesteps": timesteps, "episodes": episodes, "eval_episodes": eval_episodes}
    given = {name: value for name, value in own.items() if value is not None}
    job = _job(cmdp, method, cmdp.trainer_for(preset or preset_on_all(cmdp_id), **given))
    free = ("seeds", "first_seed", "out", "work", "as_json")
    command = f"{repeated(context, free)} --seeds 1 --first-seed"
    name = "-".join(filter(None, (job.method, other, score)))
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


def _job(cmdp: CMDP, method: str | None, one: Trainer) -> InJax | InSimulator:
    """The baseline whose training is as long as that of one source."""
    assert isinstance(one, SB3Trainer | WorldTrainer)
    if isinstance(one, WorldTrainer) and one.episodes is None:
        known: tuple[Method, ...] = get_args(Method)
        if method is not None and method not in known:
            raise unknown_name("method", method, known)
        return InJax(one, cmdp.space.contexts, method or "ppo", one.length)
    own = str(one.algorithm).lower()
    if method not in (None, own):
        raise unknown_name(f"method for {cmdp.id!r}", str(method), [own])
    if isinstance(one, WorldTrainer):  # an update per episode, as many as there are
        each = one.hyperparameters.get("n_episodes", 1)
        one = replace(one, hyperparameters={**one.hyperparameters, "n_episodes": each})
    return InSimulator(one, cmdp.space.contexts, _problem(cmdp))


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
    begin, code = time.perf_counter(), here()  # of the code that runs, not of later commits
    with bar(f"{cmdp} {name} seed {seed}", job.length) as tell:
        folder = work / f"multitask-{cmdp}-{name}-seed{seed}"
        returns, std, record = train_on_all(job, seed, folder, tell)
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
