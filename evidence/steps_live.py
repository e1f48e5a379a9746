"""Paid in steps, live: `mbtl run --steps` against what the replay of transfer curves predicts.

    .venv/bin/python evidence/steps_live.py [--seed 0] [--folder runs/steps-live]

Each run is the command that it prints. Its seed is the one of the curves, so its trainings are
theirs; its evaluation episodes are others. The replay is asked at the steps that the run has paid,
and over all seeds of the curves, which says how much of a difference is luck.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

import mbtl
from mbtl.actions import Pilot
from mbtl.benchmark import load_curves
from mbtl.benchmark.steps import StepWorld, replay_steps
from mbtl.cmdps import get_cmdp

HERE = Path(__file__)
BUDGETS = {
    "cartpole-length": 2_000_000,
    "cartpole-masspole": 1_000_000,
    "pendulum-length": 2_000_000,
}
pendulum_length = get_cmdp("pendulum-length", visibility="hidden")
"""As its shipped curves are: `mbtl run evidence/steps_live.py:pendulum_length`."""
OWN = {"pendulum-length": ("pendulum_length", "hidden")}


def predicted(name: str, budget: float, seed: int) -> tuple[float, float]:
    """V of the replay at so many steps, and the share of them that is evaluation."""
    curves = load_curves(name, OWN[name][1] if name in OWN else "default")
    run = replay_steps(Pilot(), StepWorld(curves, seed), budget)
    return float(run.value[-1]), run.evaluation_share


def live(name: str, budget: int, seed: int, folder: Path) -> dict[str, object]:
    """The summary of a run."""
    problem = f"{HERE}:{OWN[name][0]}" if name in OWN else name
    command = ["mbtl", "run", problem, "--preset", "full", "--steps", str(budget)]
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
    wishes = parser.parse_args()
    heads = ("CMDP", "budget", "paid", "V live", "margin", "V replay, this seed", "other seeds",
             "evaluation live", "replay")  # fmt: skip
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for name in [wishes.only] if wishes.only else BUDGETS:
        found = live(name, BUDGETS[name], wishes.seed, wishes.folder)
        spent, prices = float(found["spent"]), found["prices"]
        value, share = predicted(name, spent, wishes.seed)
        rest = [predicted(name, spent, s)[0] for s in range(3) if s != wishes.seed]
        others = " ".join(f"{v:.3f}" for v in np.array(rest))
        print(
            f"| {name} | {BUDGETS[name]:,} | {spent:,.0f} | {found['fresh_value']:.3f} | "
            f"{found['fresh_margin']:.3f} | {value:.3f} | {others} | "
            f"{prices['evaluation'] / spent:.0%} | {share:.0%} |",
            flush=True,
        )
    print(f"mbtl {mbtl.__version__}", file=sys.stderr)


if __name__ == "__main__":
    main()
