"""One policy for all contexts at every length of a study, for `steps.py`: its rows.

    .venv/bin/python evidence/step_wide.py [--cmdp pendulum-mass]

As `mbtl run --strategy committee` has it: each length is a training of its own, whose learning rate
falls to zero at its end. Seeds, lengths, episodes and their halves are those of a study and of the
shipped curves. The policy is shown the context, but for the ring's, whose trainings count episodes
and are charged with the longest ones, as all trainings in a replay. Writes
docs/data/one-policy-rows.npz; goes on where it was.

Notation (shapes): S seeds, A lengths, H = 2 halves of the episodes, N contexts.
"""

from __future__ import annotations

import measure

import argparse  # isort: skip
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.benchmark.matrix import halves
from mbtl.benchmark.steps import HORIZONS
from mbtl.cmdps import get_cmdp
from mbtl.cmdps.registry import visibility_on_all
from mbtl.seeds import MATRIX_TRIAL, evaluation_seeds, training_seed
from mbtl.study.steps.create import lengths_of
from mbtl.study.steps.prices import whole_length
from mbtl.study.steps.spec import lengths_on_all

FILE = Path(__file__).parents[1] / "docs/data/one-policy-rows.npz"
SEEDS, EPISODES = 3, 20
TIMES = {
    "pendulum-length": 2, "pendulum-mass": 4, "cartpole-length": 0.5, "cartpole-masscart": 0.25,
    "pendulum-timestep": 2, "cartpole-masspole": 0.25, "ring-acc": 4, "ring-vel": 4,
}  # fmt: skip
"""The largest length by CMDP, in whole trainings on one context."""


def trainer_of(cmdp_id: str) -> tuple[Any, Any]:
    """The contexts, and their trainer as it is shown them."""
    cmdp = get_cmdp(cmdp_id, visibility=visibility_on_all(cmdp_id))
    trainer = cmdp.trainer_for("paper" if cmdp_id.startswith("ring") else "full")
    return cmdp.space.contexts, replace(trainer, eval_episodes=EPISODES)


def row(cmdp_id: str, seed: int, number: int, length: int) -> tuple[int, np.ndarray]:
    """Steps, and (H, N) raw returns, of try `number` in a study of this seed."""
    contexts, trainer = trainer_of(cmdp_id)
    begin = training_seed(seed, MATRIX_TRIAL, len(contexts), number)
    by_steps = trainer.counts == "steps"
    many = length if by_steps else -(-length // _horizon(cmdp_id))
    reached = trainer.train(contexts, begin, length=many / trainer.whole)
    play = evaluation_seeds(seed, MATRIX_TRIAL, range(len(contexts)))
    played = trainer.evaluate(reached.policy, contexts, play)
    steps = reached.steps if by_steps else many * _horizon(cmdp_id)
    return steps, np.stack(halves(played)[0])


def _horizon(cmdp_id: str) -> int:
    return HORIZONS[cmdp_id.split("-")[0]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cmdp", action="append")
    args = parser.parse_args()
    kept = dict(np.load(FILE)) if FILE.is_file() else {}
    for cmdp_id, seed in product(args.cmdp or TIMES, range(SEEDS)):
        whole = whole_length(trainer_of(cmdp_id)[1], _horizon(cmdp_id))
        most = round(whole * TIMES[cmdp_id])
        for number, length in enumerate(lengths_on_all(lengths_of(whole), most)):
            key = f"{cmdp_id} {seed} {number}"
            if f"{key} steps" in kept:
                continue
            steps, returns = row(cmdp_id, seed, number, length)
            kept |= {f"{key} steps": np.array(steps), key: returns.astype(np.float32)}
            np.savez_compressed(FILE, **kept)
            measure.note(f"{key}: {steps:,} steps, mean return {returns.mean():.1f}")


if __name__ == "__main__":
    main()
