"""One policy for all contexts at several lengths, for `steps.py`: what it is worth when it ends.

    .venv/bin/python evidence/step_policies.py [--cmdp pendulum-mass]

Context-conditioned PPO, as `mbtl matrix multitask` has it, three seeds together; each length is a
training of its own, whose learning rate falls to zero at its end. The last weights count, so that
there are no checks to pay for. Writes docs/data/one-policy.json; goes on where it was.

Notation (shapes): S seeds, N contexts, E episodes.
"""

from __future__ import annotations

import measure

import argparse  # isort: skip
import json
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.problems import get_cmdp
from mbtl.seeds import MATRIX_TRIAL, Purpose, episode_seeds, evaluation_seeds, training_seed
from mbtl.zoo.cmdps.registry import visibility_on_all

FILE = Path(__file__).parents[1] / "docs/data/one-policy.json"
SEEDS, EPISODES = 3, 20
SHARES = {
    "cartpole": (1 / 32, 1 / 16, 1 / 8, 1 / 4),
    "pendulum": (1 / 2, 2, 4),
}
"""Beside 1 and 10, which are shipped."""
CMDPS = (
    "cartpole-length", "cartpole-masscart", "cartpole-masspole",
    "pendulum-mass", "pendulum-length", "pendulum-timestep",
)  # fmt: skip


def ends(cmdp_id: str, share: float) -> dict[str, Any]:
    """Steps, and V of each seed on fresh episodes."""
    import mbtl.engine.learners as engine

    cmdp = get_cmdp(cmdp_id, visibility=visibility_on_all(cmdp_id))
    trainer: Any = cmdp.trainer
    world, params = trainer.problem(cmdp.space.contexts)
    recipe = engine.multitask_recipe("ppo", type(world.env).__name__)
    whole = cmdp.preset("paper").timesteps or 0
    steps, n = round(whole * share), len(cmdp.space.contexts)
    seeds = [training_seed(seed, MATRIX_TRIAL, n) for seed in range(SEEDS)]
    training = engine.train_multitask(world, recipe, seeds, params, steps, checkpoint_every=steps)
    values = []
    for seed in range(SEEDS):
        play = evaluation_seeds(seed, MATRIX_TRIAL, range(n), Purpose.REPORT)
        numbers = episode_seeds(play, n, EPISODES)
        found = engine.evaluate_multitask(world, recipe, training.state.weights, params, numbers)
        assert cmdp.normalisation is not None
        values.append(float(cmdp.normalisation.normalise(found[seed]).mean()))
    return {
        "share": share,
        "steps": int(training.updates) * recipe.update_length,
        "V": [round(value, 4) for value in values],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cmdp", action="append")
    args = parser.parse_args()
    found: dict[str, list[dict[str, Any]]] = json.loads(FILE.read_text()) if FILE.is_file() else {}
    for cmdp_id in args.cmdp or CMDPS:
        for share in SHARES[cmdp_id.split("-")[0]]:
            done = found.setdefault(cmdp_id, [])
            if any(np.isclose(one["share"], share) for one in done):
                continue
            done.append(ends(cmdp_id, share))
            done.sort(key=lambda one: one["share"])
            FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
            measure.note(f"{cmdp_id}: {share:g} of a training, V {done[-1]['V']}")


if __name__ == "__main__":
    main()
