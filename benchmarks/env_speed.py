"""Steps per second of our CartPole and Pendulum against Gymnasium's CartPole-v1 and Pendulum-v1.

Each pair runs in turns, many short rounds, with the same actions and a reset whenever an episode
ends; medians over rounds. Twice: the bare classes, and as `gymnasium.make` returns them, wrapped.
Ours also append the context to the observation (visibility "multiplier", the default).

example: python benchmarks/env_speed.py
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import partial
from typing import Any

import measure
import numpy as np
from measure import Cost, cost_of, digits, median, note

PAIRS = {
    "CartPole": ("mbtl/cartpole-length-v0", "CartPole-v1"),
    "Pendulum": ("mbtl/pendulum-length-v0", "Pendulum-v1"),
}


def walk(env: Any, actions: Sequence[Any]) -> None:
    """Take the actions, one reset per episode."""
    env.reset()
    for action in actions:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()


def actions_for(env: Any, steps: int) -> list[Any]:
    """Random torques; alternating pushes on CartPole, so that episodes are of real length."""
    env.action_space.seed(0)
    if hasattr(env.action_space, "n"):
        return [np.int64(a) for a in itertools.islice(itertools.cycle((0, 1, 1, 0)), steps)]
    return [env.action_space.sample() for _ in range(steps)]


def compare(ours: Any, theirs: Any, steps: int, rounds: int) -> dict[str, Any]:
    """Steps per second of both, and their ratio (median of the rounds, processor time)."""
    envs = {"mbtl": ours, "gymnasium": theirs}
    actions = actions_for(theirs, steps)
    for env in envs.values():
        env.reset(seed=0)
        walk(env, actions[:200])
    costs: dict[str, list[Cost]] = {name: [] for name in envs}
    for _ in range(rounds):
        for name, env in envs.items():
            costs[name].append(cost_of(partial(walk, env, actions)))
    rates = {name: steps / median(each).cpu for name, each in costs.items()}
    return {
        "steps_per_second": {name: digits(rate, 3) for name, rate in rates.items()},
        "ratio": digits(rates["mbtl"] / rates["gymnasium"], 3),
    }


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--steps", type=int, default=5000, help="steps per round")
    parser.add_argument("--rounds", type=int, default=21)
    args = parser.parse_args()
    import gymnasium

    import mbtl.problems  # noqa: F401  # registers the ids

    results: dict[str, dict[str, Any]] = {}
    for name, (ours, theirs) in PAIRS.items():
        note(f"{name} ...")
        our_env, their_env = gymnasium.make(ours), gymnasium.make(theirs)
        results[name] = {
            "bare": compare(our_env.unwrapped, their_env.unwrapped, args.steps, args.rounds),
            "made": compare(our_env, their_env, args.steps, args.rounds),
        }
    document = {
        "steps": args.steps,
        "rounds": args.rounds,
        "ids": PAIRS,
        "results": results,
        "machine": measure.machine("gymnasium"),
    }
    lines = ["steps per second of processor time, and mbtl / gymnasium"]
    for name, kinds in results.items():
        for kind, result in kinds.items():
            rates = result["steps_per_second"]
            lines.append(
                f"  {name:10}{kind:6} mbtl {rates['mbtl']:10.0f}   gymnasium "
                f"{rates['gymnasium']:10.0f}   ratio {result['ratio']:.2f}"
            )
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
