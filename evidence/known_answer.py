"""Is the V that a run reports the true one? A problem with two axes whose answer is known.

    python evidence/known_answer.py --seeds 100

runs `mbtl run` on it, each seed with other luck of trainings and other noise: 100 contexts, 8
trainings, 10 targets each, 4 episodes with a standard deviation of 0.1 to 0.3. It prints how often
the true V of the policies, as the saved portfolio routes them, lies within the stated interval of
95 %: of V by the rows (most of it predicted, as one context in ten was measured), and of V on
fresh episodes (measured everywhere).
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

import mbtl
from mbtl.cli.app import app

SPACE = mbtl.ContextSpace.grid(
    {mbtl.Linear("mass", 0.2, 2.0, unit="kg"): 10, mbtl.Linear("slope", -5.0, 5.0, unit="deg"): 10}
)
UNIT = {json.dumps(c): u for c, u in zip(SPACE.contexts, SPACE.unit, strict=True)}


def train(context, seed):
    """A policy is where it was trained, and its luck."""
    luck = 0.05 * np.random.default_rng(seed).standard_normal()
    return np.array([*UNIT[json.dumps(dict(context))], luck])


def true_returns(policy, contexts):
    """(T,) mean return: falls with the distance, more to heavier and less to steeper contexts."""
    here = np.array([UNIT[json.dumps(dict(context))] for context in contexts])
    apart = here - policy[:2]
    fall = 0.6 * np.maximum(apart[:, 0], 0) + 0.3 * np.maximum(-apart[:, 0], 0)
    return 0.9 + policy[2] - fall - 0.4 * np.abs(apart[:, 1]) ** 1.5 - 0.15 * here[:, 1]


def evaluate(policy, contexts, seeds):
    """(T, 4) returns with noise that differs between policies and contexts."""
    mine = int(1e6 * abs(policy).sum())
    noise = np.array([np.random.default_rng([s, mine]).standard_normal(4) for s in seeds])
    return true_returns(policy, contexts)[:, None] + (0.1 + 0.02 * (mine % 11)) * noise


def save(policy, folder):
    """Read by `load`."""
    np.save(folder / "policy.npy", policy)


def load(folder):
    """What `save` wrote."""
    return np.load(folder / "policy.npy")


problem = mbtl.CMDP.from_functions(
    "known-answer", SPACE, train=train, evaluate=evaluate, save=save, load=load, budget=8,
    bounds=(0.0, 1.0),
)  # fmt: skip


def reported(seed: int, folder: Path) -> dict[str, tuple[float, float, float]]:
    """By name: V as `mbtl run` reports it, half its interval, and the true V."""
    words = ["run", f"{__file__}:problem", "--seed", seed, "--eval-targets", 10, "--all", "--json"]
    done = CliRunner().invoke(app, [*map(str, words), "--study", str(folder)])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    portfolio = mbtl.load_portfolio(folder / "portfolio", load=load)
    rows = [true_returns(portfolio.policy(i), SPACE.contexts) for i in range(len(portfolio))]
    true = float(np.array(rows)[portfolio.assignment, np.arange(SPACE.n)].mean())
    return {
        "by the rows": (found["value"], found["value_margin"], true),
        "on fresh episodes": (found["fresh_value"], found["fresh_margin"], true),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    seeds = parser.parse_args().seeds
    with tempfile.TemporaryDirectory() as place:
        runs = [reported(seed, Path(place) / str(seed)) for seed in range(seeds)]
    print(f"| V, {seeds} seeds | within its interval | mean error | mean half interval |")
    print("|---|---|---|---|")
    for name in runs[0]:
        said, margin, true = np.array([run[name] for run in runs]).T
        inside = int((abs(said - true) <= margin).sum())
        print(
            f"| {name} | {inside} of {seeds} | {(said - true).mean():+.4f} | {margin.mean():.4f} |"
        )


if __name__ == "__main__":
    main()
