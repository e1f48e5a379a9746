"""Training throughput of the jax engine against Stable-Baselines3, on this machine, in one run.

    .venv/bin/python benchmarks/jax_throughput.py [--policies 1 10 30 100] [--seconds 10]

Stable-Baselines3 runs its default PPO on CartPole in one process per core, one thread each; ours
trains all policies in one process. Also the float32 matrix-multiply rate, and how much of it the
trainings use (forward and backward passes counted, nothing else).
"""

from __future__ import annotations

import argparse
import os
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from multiprocessing import get_context

from mbtl.cmdps import cartpole

CORES = len(os.sched_getaffinity(0))


def sb3_rate(seconds: float) -> float:
    """Steps per second of one Stable-Baselines3 process."""
    import torch
    from stable_baselines3 import PPO

    torch.set_num_threads(1)
    model = PPO("MlpPolicy", cartpole.CartPole({"length": 0.5}), device="cpu", seed=0)
    model.learn(2048)
    begin, steps = time.perf_counter(), 0
    while (passed := time.perf_counter() - begin) < seconds:
        model.learn(2048, reset_num_timesteps=False)
        steps += 2048
    return steps / passed


def flops_per_step(recipe, n_inputs: int) -> float:
    """Matrix products per environment step: acting, two values, then three passes per epoch."""
    h1, h2 = recipe.hidden
    actor, critic = (2.0 * (n_inputs * h1 + h1 * h2 + h2 * out) for out in (2, 1))
    return actor + 2.0 * critic + recipe.n_epochs * 3.0 * (actor + critic)


def peak() -> float:
    """Float32 operations per second of a 1024 x 1024 matrix product."""
    import jax
    import jax.numpy as jnp

    product, a = jax.jit(jnp.matmul), jnp.ones((1024, 1024), jnp.float32)
    product(a, a).block_until_ready()
    times = []
    for _ in range(20):
        begin = time.perf_counter()
        product(a, a).block_until_ready()
        times.append(time.perf_counter() - begin)
    return 2.0 * 1024**3 / min(times)


def jax_rate(n_policies: int, recipe, seconds: float) -> float:
    """Steps per second of all policies together, evaluations left out, compilation too."""
    import mbtl.training.jax as engine

    lengths = [0.05 * (1 + 99 * k // max(1, n_policies - 1)) for k in range(n_policies)]
    envs = [cartpole.CartPole({"length": length}) for length in lengths]
    env = engine.CartPole()
    params = engine.stack_params(
        env, [cartpole.derive(e.features) for e in envs], [e.visible for e in envs]
    )
    per_update = recipe.steps_per_update
    marks: list[tuple[int, float]] = []

    class Enough(Exception):
        pass

    def watch(block: engine.Block) -> None:
        marks.append((block.steps, time.perf_counter()))
        if len(marks) > 1 and marks[-1][1] - marks[0][1] > seconds:
            raise Enough

    every = per_update * max(1, round(8192 / per_update))
    with suppress(Enough):
        engine.train(
            env, recipe, range(n_policies), params, 10**8,
            checkpoint_every=every, checkpoint_episodes=1, on_block=watch,
        )  # fmt: skip
    (first, begin), (last, end) = marks[0], marks[-1]
    return n_policies * (last - first) / (end - begin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policies", type=int, nargs="+", default=[1, 10, 30, 100])
    parser.add_argument("--seconds", type=float, default=10.0, help="per measurement")
    args = parser.parse_args()
    with ProcessPoolExecutor(CORES, mp_context=get_context("spawn")) as pool:
        peer = sum(pool.map(sb3_rate, [args.seconds] * CORES))
    print(f"Stable-Baselines3, {CORES} processes: {peer:,.0f} steps/s", flush=True)
    import mbtl.training.jax as engine

    rate = peak()
    print(f"float32 matrix product: {rate / 1e9:.0f} GFLOP/s", flush=True)
    print("recipe  policies     steps/s   x SB3   of peak")
    for name in ("sb3", "fast"):
        for n_policies in args.policies:
            steps = jax_rate(n_policies, engine.recipe_named("PPO", name), args.seconds)
            share = steps * flops_per_step(engine.recipe_named("PPO", name), 5) / rate
            print(
                f"{name:6}  {n_policies:8d}  {steps:10,.0f}  {steps / peer:6.1f}  {share:8.1%}",
                flush=True,
            )


if __name__ == "__main__":
    main()
