"""Eco-green by both scores in SUMO: choices at random, no controller, and a trained policy.

The policy is the nearest that `mbtl run eco-green --budget 1` kept in runs (see films.py).

example: python evidence/eco_scores.py --greens 25 35
"""

from __future__ import annotations

import argparse
from pathlib import Path

import films
import numpy as np

NAMES = ("mean_speed", "trip_speed", "throughput", "co2", "stops")
EPISODES = 3


def main() -> None:
    """Three episodes of each, and their mean."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--policies", type=Path, default=Path("runs"), help="where they are kept")
    parser.add_argument("--greens", type=float, nargs="+", default=[25.0], help="seconds")
    args = parser.parse_args()
    cmdp, rng = films.simulated("eco-green"), np.random.default_rng(0)
    print(f"| green | who | {' | '.join(NAMES)} |\n|{'---|' * (2 + len(NAMES))}")
    for green in args.greens:
        policy, _ = films.kept(cmdp, {"green": green}, args.policies)
        assert cmdp.make_env is not None
        env = cmdp.make_env({"green": green})
        for who in ("random", "unguided", "trained"):
            found = []
            for seed in range(EPISODES):
                seen, _ = env.reset(seed=seed)
                while env.agents:
                    told = {}
                    if who == "random":
                        told = {car: rng.uniform(-20.0, 10.0, 1) for car in env.agents}
                    elif who == "trained":
                        views = np.stack([seen[car] for car in env.agents])
                        advice, _ = policy.predict(views, deterministic=True)
                        told = dict(zip(env.agents, advice, strict=True))
                    seen = env.step(told)[0]
                found.append([env.summary[name] for name in NAMES])
            each = np.array(found).T
            cells = [f"{' '.join(f'{x:.3g}' for x in one)} ({one.mean():.3g})" for one in each]
            print(f"| {green:g} s | {who} | {' | '.join(cells)} |", flush=True)
        env.close()


if __name__ == "__main__":
    main()
