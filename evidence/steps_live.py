"""Paid in steps, live: `mbtl run --steps` against what the replay of transfer curves predicts.

    .venv/bin/python evidence/steps_live.py [--seed 0] [--folder runs/steps-live]
    .venv/bin/python evidence/steps_live.py --only ID --strategy committee --steps 800000

Each run is the command that it prints. Its seed is the one of the curves, so its trainings are
theirs, and its evaluations begin with the same episodes; V live is of a hundred fresh episodes, V
of the replay of ten. The replay is asked at the steps that the run has paid, and on the other seeds
of the curves, which says how much is luck.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from step_generalist import on_all

import mbtl
from mbtl.benchmark import TransferCurves, load_curves
from mbtl.benchmark.steps import StepRun, StepWorld, replay_steps
from mbtl.cmdps import get_cmdp
from mbtl.study.steps.evaluation import fresh_returns
from mbtl.study.steps.strategies import strategy_named

HERE = Path(__file__)
BUDGETS = {
    "cartpole-length": 2_000_000,
    "cartpole-masspole": 1_000_000,
    "pendulum-length": 2_000_000,
}
pendulum_length = get_cmdp("pendulum-length", visibility="hidden")
"""As its shipped curves are: `mbtl run evidence/steps_live.py:pendulum_length`."""
OWN = {"pendulum-length": ("pendulum_length", "hidden")}


def world_of(name: str, seed: int) -> StepWorld:
    """What was recorded."""
    return StepWorld(curves_of(name), seed, on_all=on_all(name, seed))


def predicted(name: str, strategy: str, budget: float, seed: int) -> StepRun:
    """The replay of so many steps."""
    return replay_steps(strategy_named(strategy), world_of(name, seed), budget)


def in_episodes_of_the_replay(name: str, study: mbtl.StepStudy) -> float:
    """V of the live portfolio where its policies play the ten episodes of the replay's V."""
    world, trail = world_of(name, study.spec.seed), study.trail
    fresh = np.array([
        world.rows_of(trail.trainings[p.training], p.length)[1] for p in trail.policies
    ])  # fmt: skip
    route = study.portfolio().assignment
    return float(fresh[route, np.arange(len(route))].mean())


def curves_of(name: str) -> TransferCurves:
    """The shipped ones."""
    return load_curves(name, OWN[name][1] if name in OWN else "default")


def in_common(study: mbtl.StepStudy, run: StepRun) -> str:
    """Policies that both have, in the same order from the first one on."""
    ours, theirs = ([(t.trainings[p.training].source, p.length, bool(t.trainings[p.training].on))
                     for p in t.policies] for t in (study.trail, run.trail))  # fmt: skip
    same = 0
    while same < min(len(ours), len(theirs)) and ours[same] == theirs[same]:
        same += 1
    return f"first {same} of {len(ours)} and {len(theirs)}"


def live(name: str, strategy: str, budget: int, seed: int, folder: Path) -> dict[str, object]:
    """The summary of a run."""
    problem = f"{HERE}:{OWN[name][0]}" if name in OWN else name
    command = ["mbtl", "run", problem, "--preset", "full", "--steps", str(budget)]
    command += ["--strategy", strategy]
    command += ["--seed", str(seed), "--study", str(folder / name), "--json"]
    print("$", *command, file=sys.stderr)
    command[0] = str(Path(sys.executable).with_name("mbtl"))
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    found: dict[str, object] = json.loads(done.stdout)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("runs/steps-live"))
    parser.add_argument("--only", choices=list(BUDGETS))
    parser.add_argument("--strategy", default="pilot")
    parser.add_argument("--steps", type=int)
    wishes = parser.parse_args()
    heads = ("CMDP", "budget", "paid", "V live", "in the replay's episodes", "V replay",
             "other seeds", "same policies", "evaluation live", "replay")  # fmt: skip
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for name in [wishes.only] if wishes.only else BUDGETS:
        budget = wishes.steps or BUDGETS[name]
        found = live(name, wishes.strategy, budget, wishes.seed, wishes.folder)
        spent, prices = float(found["spent"]), found["prices"]
        replay = predicted(name, wishes.strategy, spent, wishes.seed)
        rest = [
            predicted(name, wishes.strategy, spent, s).value[-1]
            for s in range(3)
            if s != wishes.seed
        ]
        others = " ".join(f"{value:.3f}" for value in rest)
        study = mbtl.StepStudy.load(wishes.folder / name)
        problem = pendulum_length if name in OWN else get_cmdp(name)
        fresh = fresh_returns(study, problem.trainer_for("full"))
        value = study.bounds.normalise(fresh.returns).mean()
        margin = 1.96 * fresh.error / abs(study.bounds.high - study.bounds.low)
        same = in_common(study, replay)
        print(
            f"| {name} | {budget:,} | {spent:,.0f} | {value:.3f} +- {margin:.3f} | "
            f"{in_episodes_of_the_replay(name, study):.3f} | {replay.value[-1]:.3f} | "
            f"{others} | {same} | "
            f"{prices['evaluation'] / spent:.0%} | {replay.evaluation_share:.0%} |",
            flush=True,
        )
    print(f"mbtl {mbtl.__version__}", file=sys.stderr)


if __name__ == "__main__":
    main()
