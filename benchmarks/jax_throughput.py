"""Training throughput of the jax engine against Stable-Baselines3, in one run.

    .venv/bin/python benchmarks/jax_throughput.py [--policies 1 2 8 30 100 400] [--seconds 10]

Both run one process per core, one thread each, CartPole and PPO. A rate is steps per second of
processor time, summed over the processes: what the machine does when nobody else uses it. Also the
float32 matrix-multiply rate, the share of it that training uses (matrix products of acting, values
and gradients counted, nothing else), and the memory of a process.
"""

from __future__ import annotations

import measure  # noqa: F401  first: threads

import argparse  # isort: skip
import resource
import time
from typing import Any

import rates
from rates import CORES, on_every_core

RECIPES = ("sb3", "fast")


def sb3_rate(seconds: float, barrier: Any) -> float:
    """Steps per second of processor time of one Stable-Baselines3 process."""
    import torch
    from stable_baselines3 import PPO

    from mbtl.zoo.cmdps import cartpole

    torch.set_num_threads(1)
    model = PPO("MlpPolicy", cartpole.CartPole({"length": 0.5}), device="cpu", seed=0)
    return rates.of_sb3(model, seconds, barrier)


def flops_per_step(recipe: Any, n_inputs: int) -> float:
    """Matrix products per environment step: acting, two values, then three passes per epoch."""
    h1, h2 = recipe.hidden
    actor, critic = (2.0 * (n_inputs * h1 + h1 * h2 + h2 * out) for out in (2, 1))
    return actor + 2.0 * critic + recipe.n_epochs * 3.0 * (actor + critic)


def peak() -> float:
    """Float32 operations per second of processor time of a 1024 x 1024 product, one thread."""
    import numpy as np

    a = np.ones((1024, 1024), np.float32)
    times = []
    for _ in range(20):
        begin = time.process_time()
        _ = a @ a
        times.append(time.process_time() - begin)
    return 2.0 * 1024**3 / min(times)


def jax_rate(n_policies: int, name: str, seconds: float, barrier: Any) -> tuple[float, float]:
    """(steps per second of processor time, peak MB) of one process that trains `n_policies`."""
    import mbtl.engine.learners as engine
    from mbtl.problems import get_cmdp

    cmdp = get_cmdp("cartpole-length", engine="jax")
    lengths = [0.05 * (1 + 99 * k // max(1, n_policies - 1)) for k in range(n_policies)]
    env, params = cmdp.trainer.problem([{"length": length} for length in lengths])
    recipe = engine.recipe_named("PPO", name)
    every = recipe.update_length * max(1, round(8192 / recipe.update_length))
    rate = rates.of_engine(env, recipe, range(n_policies), params, every, seconds, barrier)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return n_policies * rate, memory


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policies", type=int, nargs="+", default=[1, 2, 8, 30, 100, 400])
    parser.add_argument("--seconds", type=float, default=10.0, help="per measurement")
    args = parser.parse_args()
    import mbtl.engine.learners as engine

    rate = peak() * CORES
    print(f"float32 matrix product, {CORES} cores: {rate / 1e9:.0f} GFLOP/s", flush=True)
    peer = sum(on_every_core(sb3_rate, args.seconds))
    print(f"Stable-Baselines3, {CORES} processes: {peer:,.0f} steps/s", flush=True)
    print("recipe  policies/process     steps/s   x SB3   of peak   MB/process")
    for name in RECIPES:
        for n_policies in args.policies:
            results = on_every_core(jax_rate, n_policies, name, args.seconds)
            steps, memory = sum(r for r, _ in results), max(m for _, m in results)
            share = steps * flops_per_step(engine.recipe_named("PPO", name), 5) / rate
            print(
                f"{name:6}  {n_policies:16d}  {steps:10,.0f}  {steps / peer:6.1f}  {share:8.1%}"
                f"  {memory:10,.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
