"""One policy for all contexts along one training, for `steps.py`: its rows at every doubling.

    .venv/bin/python evidence/step_wide.py [--cmdp pendulum-mass]

One training goes on from mark to mark, as `mbtl run --strategy committee` has it: seeds, marks,
episodes and their halves are those of a study and of the shipped curves. The policy is shown the
context. Writes docs/data/one-policy-rows.npz; goes on where it was.

Notation (shapes): S seeds, A marks, H = 2 halves of the episodes, N contexts.
"""

from __future__ import annotations

import measure

import argparse  # isort: skip
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.benchmark.entries import halves
from mbtl.cmdps import get_cmdp
from mbtl.cmdps.registry import visibility_on_all
from mbtl.seeds import MATRIX_TRIAL, evaluation_seed, training_seed
from mbtl.study.steps.create import lengths_of
from mbtl.study.steps.spec import lengths_on_all

FILE = Path(__file__).parents[1] / "docs/data/one-policy-rows.npz"
SEEDS, EPISODES = 3, 20
TIMES = {"cartpole": 1, "pendulum": 16}
"""Length of the training, in whole ones on a single context."""
CMDPS = (
    "pendulum-mass", "pendulum-length", "cartpole-length",
    "pendulum-timestep", "cartpole-masscart", "cartpole-masspole",
)  # fmt: skip


def rows(cmdp_id: str, seed: int) -> dict[str, Any]:
    """`steps` (A,) and `returns` (A, H, N), raw, of the policy at each mark."""
    cmdp = get_cmdp(cmdp_id, visibility=visibility_on_all(cmdp_id))
    trainer: Any = replace(cmdp.trainer_for("full"), eval_episodes=EPISODES)
    contexts = cmdp.space.contexts
    whole = trainer.whole_steps
    marks = lengths_on_all(lengths_of(whole), whole * TIMES[cmdp_id.split("-")[0]])
    steps, found = [], []
    with tempfile.TemporaryDirectory() as folder:
        for mark in marks:
            reached = trainer.train_on_steps(
                contexts, training_seed(seed, MATRIX_TRIAL, len(contexts)), mark,
                marks=marks, saved=Path(folder) / "training.npz",
            )  # fmt: skip
            steps.append(reached.steps)
            play = evaluation_seed(seed, MATRIX_TRIAL)
            found.append(trainer.evaluate(reached.policy, contexts, play))
    means, _ = halves(np.stack(found))  # each (A, N)
    return {"steps": np.array(steps), "returns": np.stack(means, axis=1)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cmdp", action="append")
    args = parser.parse_args()
    kept = dict(np.load(FILE)) if FILE.is_file() else {}
    for cmdp_id in args.cmdp or CMDPS:
        for seed in range(SEEDS):
            if f"{cmdp_id} {seed} steps" in kept:
                continue
            one = rows(cmdp_id, seed)
            kept[f"{cmdp_id} {seed} steps"] = one["steps"]
            kept[f"{cmdp_id} {seed} returns"] = one["returns"].astype(np.float32)
            np.savez_compressed(FILE, **kept)
            measure.note(f"{cmdp_id}, seed {seed}: {one['returns'].mean(axis=(1, 2)).round(1)}")


if __name__ == "__main__":
    main()
