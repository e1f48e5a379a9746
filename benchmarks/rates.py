"""Rates of training: steps per second of processor time, on every core at once."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from multiprocessing import get_context
from typing import Any

from mbtl.processes import usable_cores

CORES = usable_cores()


def of_sb3(model: Any, seconds: float, barrier: Any) -> float:
    """Steps per second of a Stable-Baselines3 model, after its first rollout."""
    model.learn(2048)
    barrier.wait()
    begin, wall, steps = time.process_time(), time.perf_counter(), 0
    while time.perf_counter() - wall < seconds:
        model.learn(2048, reset_num_timesteps=False)
        steps += 2048
    return steps / (time.process_time() - begin)


def of_engine(
    world: Any,
    recipe: Any,
    seeds: Sequence[int],
    params: Any,
    every: int,
    seconds: float,
    barrier: Any,
) -> float:
    """Steps per second of one policy in the engine, after the first `every` steps, which compile.

    Args:
        world: the dynamics.
        recipe: hyper-parameters.
        seeds: one per policy.
        params: of their contexts.
        every: steps between two looks at the clock, with an evaluation of one episode.
        seconds: that are measured.
        barrier: of all processes.
    """
    import mbtl.engine.learners as engine

    marks: list[tuple[int, float]] = []
    started = 0.0

    class Enough(Exception):
        pass

    def watch(block: engine.Block) -> None:
        nonlocal started
        if not marks:  # compiled by now
            barrier.wait()
            started = time.perf_counter()
        marks.append((block.steps, time.process_time()))
        if len(marks) > 1 and time.perf_counter() - started > seconds:
            raise Enough

    with suppress(Enough):
        engine.train(
            world, recipe, seeds, params, 10**8,
            checkpoint_every=every, checkpoint_episodes=1, on_block=watch,
        )  # fmt: skip
    (first, begin), (last, end) = marks[0], marks[-1]
    return (last - first) / (end - begin)


def on_every_core(work: Any, *arguments: Any) -> list[Any]:
    """`work` at the same time in one fresh process per core; its last argument is their barrier."""
    context = get_context("spawn")
    with context.Manager() as manager, ProcessPoolExecutor(CORES, mp_context=context) as pool:
        barrier = manager.Barrier(CORES)
        doing = [pool.submit(work, *arguments, barrier) for _ in range(CORES)]
        return [one.result() for one in doing]
