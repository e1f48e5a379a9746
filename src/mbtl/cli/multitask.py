"""`mbtl matrix multitask`: baselines that train one policy on all contexts."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from mbtl.benchmark.multitask import multitask_file, save_multitask
from mbtl.benchmark.provenance import here
from mbtl.cli.common import JsonFlag, console, print_json
from mbtl.cmdps import CMDP, get_cmdp
from mbtl.errors import InvalidInput
from mbtl.training import JaxTrainer

Method = Literal["ppo", "paco", "moore"]


def multitask(
    cmdp_id: Annotated[str, typer.Argument(metavar="CMDP", help="Id of a CMDP simulated in jax.")],
    method: Annotated[Method, typer.Option(help="ppo is context-conditioned PPO.")] = "ppo",
    factor: Annotated[
        int, typer.Option(help="Environment steps, as a multiple of one source's.")
    ] = 1,
    seeds: Annotated[int, typer.Option(help="Number of policies, one per seed.")] = 3,
    first_seed: Annotated[int, typer.Option(help="Seed of the first.")] = 0,
    timesteps: Annotated[
        int | None, typer.Option(help="Environment steps of one source; default: the paper's.")
    ] = None,
    eval_episodes: Annotated[int, typer.Option(help="Episodes per context.")] = 100,
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
    for name, number in (("seeds", seeds), ("factor", factor)):
        if number < 1:
            raise InvalidInput(f"--{name} must be >= 1, got {number}")
    cmdp = get_cmdp(cmdp_id, engine="jax")
    steps = (cmdp.preset("paper").timesteps or 0) if timesteps is None else timesteps
    name = method if factor == 1 else f"{method}-x{factor}"
    results = []
    for seed in range(first_seed, first_seed + seeds):
        file = multitask_file(out, cmdp.id, name, seed)
        if file.is_file():
            console.print(f"{file}: there already", markup=False)
            continue
        command = f"mbtl matrix multitask {cmdp.id} --method {method}"
        command += f" --factor {factor}" if factor > 1 else ""
        command += f" --timesteps {timesteps}" if timesteps is not None else ""
        results.append(
            _one(
                cmdp,
                method,
                name,
                seed,
                steps * factor,
                f"{command} --seeds 1 --first-seed {seed}",
                episodes=eval_episodes,
                out=out,
                work=work,
            )
        )
    if as_json:
        print_json({"baselines": results})


def _one(
    cmdp: CMDP,
    method: Method,
    name: str,
    seed: int,
    timesteps: int,
    command: str,
    *,
    episodes: int,
    out: Path,
    work: Path,
) -> dict[str, Any]:
    import mbtl.training.jax as engine

    assert isinstance(cmdp.trainer, JaxTrainer)
    env, params = cmdp.trainer.problem(cmdp.space.contexts)
    recipe = engine.multitask_recipe(method, type(env).__name__)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=30),
        TextColumn("{task.fields[note]}", markup=False),
        TimeRemainingColumn(),
    )
    begin = time.perf_counter()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(f"{cmdp.id} {name} seed {seed}", total=timesteps, note="")

        def on_progress(_: int, done: int, total: int, mean_return: float) -> None:
            bar.update(task, completed=done, total=total, note=f"return {mean_return:.0f}")

        run = engine.run_multitask(
            env,
            recipe,
            params,
            [seed],
            timesteps,
            work / f"multitask-{cmdp.id}-{name}-seed{seed}",
            episodes=episodes,
            on_progress=on_progress,
        )
    best = run.returns["best"][0]
    provenance = {
        **run.provenance[0],
        "problem": cmdp.id,
        "switches": dict(cmdp.settings),
        "checkpoint": "best",
        "final_mean_return": float(run.returns["final"].mean()),
        "command": command,
        "wall_seconds_of_last_run": round(time.perf_counter() - begin, 1),
        **here(),
    }
    file = save_multitask(best, run.std["best"][0], provenance, out, cmdp.id, name, seed)
    assert cmdp.normalisation is not None
    value = float(cmdp.normalisation.normalise(best).mean())
    console.print(f"{file}: V = {value:.4f}", markup=False, highlight=False, soft_wrap=True)
    return {"file": str(file), "performance": value}
