"""Does the twin of the signal agree with SUMO, and how fast is it?

    taskset -c 0 python evidence/signal_twin.py [--seeds 6] [--axes inflow length speed]

Two policies that need no training: the four phases in turn, 30 s each, and phases at random. The
contexts are the nominal one and others along the axes. Measures are the score (minus the
waiting), cars that stand and the mean speed of cars on the approaches, at decisions. A difference
is given in its standard errors. The last columns are processor milliseconds of an episode in SUMO
(in this process, with our calls) and in the twin (64 intersections at once). Markdown.
"""

from __future__ import annotations

import measure

import argparse  # isort: skip
import time
from functools import partial
from typing import Any

import numpy as np

CONTEXTS: list[dict[str, float]] = [
    {}, {"inflow": 300.0}, {"inflow": 1500.0}, {"inflow": 2000.0},
    {"length": 50.0}, {"length": 100.0}, {"length": 2500.0},
    {"speed": 1.5}, {"speed": 2.5}, {"speed": 3.5}, {"speed": 5.0}, {"speed": 25.0},
]  # fmt: skip
NAMES = ("score", "mean_queue", "mean_speed")
HELD = 3
"""Decisions for which a phase of the light that takes turns has green."""
COPIES = 64


def in_sumo(features: dict[str, float], policy: str, seeds: int) -> tuple[np.ndarray, float]:
    """(seeds, measures), and processor milliseconds of an episode."""
    from mbtl.zoo.cmdps.traffic.signal import Signal

    env, found = Signal(features, visibility="hidden", score="paper"), []
    began = time.process_time()
    for seed in range(seeds):
        env.reset(seed=seed)
        rng, ended, k, info = np.random.default_rng(seed), False, 0, {}
        while not ended:
            phase = (k // HELD) % 4 if policy == "in turn" else int(rng.integers(4))
            *_, terminated, truncated, info = env.step(phase)
            ended, k = terminated or truncated, k + 1
        found.append([info[name] for name in NAMES])
    spent = time.process_time() - began
    env.close()
    return np.array(found), 1e3 * spent / seeds


def in_twin(features: dict[str, float], policy: str) -> tuple[np.ndarray, float]:
    """The same of the twin."""
    import mbtl.engine.learners  # noqa: F401  isort: skip  # first: flags of jax
    import jax
    import jax.numpy as jnp

    from mbtl.zoo.cmdps.traffic.twins import SignalProblem

    twin, (params,) = SignalProblem(score="paper")([features])

    def one(seeds: Any, k: Any, state: Any) -> Any:
        if policy == "in turn":
            action = jnp.full((COPIES, 1), (k // HELD) % 4)
        else:
            action = twin.any_actions(seeds, k)
        return twin.step(state, action, params).state

    @jax.jit
    def play(seeds: Any) -> Any:
        state = twin.start(seeds, params)
        return jax.lax.fori_loop(0, twin.decisions(params), partial(one, seeds), state)

    seeds = jnp.arange(COPIES, dtype=jnp.uint32)
    jax.block_until_ready(play(seeds))
    began = time.process_time()
    state = jax.block_until_ready(play(seeds))
    spent = time.process_time() - began
    measures = twin.measures(state)
    return np.array([measures[name] for name in NAMES]).T, 1e3 * spent / COPIES


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--axes", nargs="+", default=["inflow", "length", "speed"])
    args = parser.parse_args()
    heads = ("score", "standing cars", "speed, m/s")
    columns = " | ".join(f"{head}: SUMO | twin | errors apart" for head in heads)
    print(f"| context | phases | {columns} | ms: SUMO | twin | times |")
    print("|---" * (5 + 3 * len(heads)) + "|")
    for features in CONTEXTS:
        if not set(features) <= set(args.axes):
            continue
        name = ", ".join(f"{k} {v:g}" for k, v in features.items()) or "nominal"
        for policy in ("in turn", "at random"):
            sumo, slow = in_sumo(features, policy, args.seeds)
            twin, fast = in_twin(features, policy)
            cells = []
            for theirs, ours in zip(sumo.T, twin.T, strict=True):
                error = np.hypot(theirs.std(ddof=1) / len(sumo) ** 0.5, ours.std() / COPIES**0.5)
                apart = (ours.mean() - theirs.mean()) / max(error, 1e-9)
                cells += [f"{theirs.mean():.2f}", f"{ours.mean():.2f}", f"{apart:+.1f}"]
            cells += [f"{slow:.0f}", f"{fast:.0f}", f"{slow / fast:.0f}"]
            print(f"| {name} | {policy} | {' | '.join(cells)} |", flush=True)
            measure.note(f"{name}, {policy}")


if __name__ == "__main__":
    main()
