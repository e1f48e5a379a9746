"""Do the fast recipes end as high as Stable-Baselines3's? The same steps, many contexts and seeds.

    .venv/bin/python evidence/jax_recipes.py [--cmdp cartpole-length] [--steps 1000000]

Trains 10 contexts x 3 seeds by two recipes in the jax engine (`jax_parity.py` shows that its `sb3`
is Stable-Baselines3's) and prints mean returns of best and final policies on 100 fresh episodes of
the own context, their difference with a 90 % interval over the trainings, and the processor time.
"""

from __future__ import annotations

import measure  # noqa: F401  first: threads

import argparse  # isort: skip
import time

import numpy as np
from scipy import stats

SOURCES, SEEDS = (0, 4, 9, 19, 29, 39, 49, 64, 79, 99), 3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cmdp", default="cartpole-length")
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--algorithm", default="PPO")
    args = parser.parse_args()
    from mbtl.problems import get_cmdp
    from mbtl.seeds import evaluation_seeds, training_seed

    cmdp = get_cmdp(args.cmdp, engine="jax")
    contexts = [cmdp.space.contexts[s] for s in SOURCES for _ in range(SEEDS)]
    seeds = [training_seed(seed, 0, s) for s in SOURCES for seed in range(SEEDS)]
    found = {}
    for name in ("sb3", "default"):
        options = {"algorithm": args.algorithm, "timesteps": args.steps}
        if name == "sb3":
            options |= {"recipe_name": "sb3"}
        trainer = cmdp.trainer_for("full", **options)
        if name == "sb3":  # nothing of our own on top of it
            trainer = type(trainer)(
                trainer.problem, timesteps=args.steps, recipe_name="sb3", algorithm=args.algorithm
            )
        begin = time.process_time()
        policies = trainer.train_many(contexts, seeds)
        seconds = time.process_time() - begin
        for checkpoint in ("best", "final"):
            own = [
                trainer.evaluate(policy, [context], evaluation_seeds(0, 0, [0])).mean()
                for policy, context in zip(policies[checkpoint], contexts, strict=True)
            ]
            found[name, checkpoint] = np.array(own)
        print(
            f"{name}: {seconds:.0f} s of processor time for {len(contexts)} trainings", flush=True
        )
    print(
        f"{args.cmdp}, {args.algorithm}, {args.steps:,} steps; mean return per source, best policy"
    )
    print("multiplier " + " ".join(f"{(s + 1) / 10:7.1f}" for s in SOURCES))
    for name in ("sb3", "default"):
        means = found[name, "best"].reshape(-1, SEEDS).mean(axis=1)
        print(f"{name:10} " + " ".join(f"{m:7.1f}" for m in means))
    low, high = cmdp.bounds
    for checkpoint in ("best", "final"):
        ours, peer = found["default", checkpoint], found["sb3", checkpoint]
        gap = ours - peer
        half = stats.t.ppf(0.95, len(gap) - 1) * gap.std(ddof=1) / np.sqrt(len(gap))
        print(
            f"{checkpoint}: sb3 {peer.mean():.1f}, ours {ours.mean():.1f}; difference "
            f"{gap.mean():.1f} +- {half:.1f} ({100 * gap.mean() / (high - low):+.1f} "
            f"+- {100 * half / (high - low):.1f} % of the bounds)"
        )


if __name__ == "__main__":
    main()
