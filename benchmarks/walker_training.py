"""BipedalWalker: what a step costs, and what training gives, beside Stable-Baselines3.

    python benchmarks/walker_training.py [--part step rate learning] [--steps 1000000] [--seeds 1]

`step` is of one core: Gymnasium's BipedalWalker-v3, our environment alone, our walkers together,
and what of that is Box2D, all with walking actions; the lower tenth of many short measurements.
`rate` trains for --seconds on every core at once, one process each: Stable-Baselines3 with its
default PPO on Gymnasium's environment, and the recipe of the CMDP in the engine, with Box2D's
walkers and with those in jax. Rates are steps per second of processor time, added up over cores,
with learning and all else.
`learning` trains Stable-Baselines3's and the walker in jax in the nominal context for as many
--steps, one after the other, and prints what policies return on the way, both in Box2D: mean
actions, fresh episodes of 1000 steps.
"""

from __future__ import annotations

import measure  # noqa: F401  first: threads

import argparse  # isort: skip
import functools
import os
import time
from typing import Any

import numpy as np
import rates
from rates import CORES, on_every_core

HORIZON, EPISODES = 1000, 10
NOMINAL = {"gravity": 10.0}


def gymnasium_walker() -> Any:
    """Theirs, with the horizon of the CMDP."""
    import gymnasium

    return gymnasium.make("BipedalWalker-v3", max_episode_steps=HORIZON)


def sb3_model(seed: int) -> Any:
    """Stable-Baselines3's PPO with its defaults."""
    import torch
    from stable_baselines3 import PPO

    torch.set_num_threads(1)
    return PPO("MlpPolicy", gymnasium_walker(), device="cpu", seed=seed)


# ---- a step ----------------------------------------------------------------------------------


def step_costs() -> dict[str, float]:
    """Microseconds of processor time."""
    from gymnasium.envs.box2d.bipedal_walker import BipedalWalker, BipedalWalkerHeuristics

    from mbtl.cmdps.locomotion import walker
    from mbtl.cmdps.locomotion.walker_body import Constants, Walker, advance

    def walking(env: Any) -> tuple[list[Any], list[float]]:
        seen, heuristic, actions, costs = env.reset(seed=5)[0], BipedalWalkerHeuristics(), [], []
        heuristic.a = np.zeros(4)
        for _ in range(300):
            actions.append(heuristic.step_heuristic(seen).astype(np.float32))
            begin = time.thread_time()
            seen, _, ended, *_ = env.step(actions[-1])
            costs.append(time.thread_time() - begin)
            if ended:
                break
        return actions, costs

    found = {
        "Gymnasium's BipedalWalker": least(walking(BipedalWalker())[1]),
        "our environment": least(walking(walker.BipedalWalker(NOMINAL))[1]),
    }
    rng = np.random.default_rng(0)
    for n in (1, 8, 32):
        herd = [Walker(Constants(10.0, 2.5, 30.0), rng.random(300)) for _ in range(n)]
        each = [BipedalWalkerHeuristics() for _ in herd]
        for one in each:
            one.a = np.zeros(4)
        seen = advance(herd, np.zeros((n, 4), np.float32))[0]
        together, alone = [], []
        for k in range(400):
            action = np.array([h.step_heuristic(s) for h, s in zip(each, seen, strict=True)])
            begin = time.thread_time()
            if k % 2:
                for one in herd:
                    one.world.Step(0.02, 180, 60)
                alone.append((time.thread_time() - begin) / n)
            else:
                seen = advance(herd, action.astype(np.float32))[0]
                together.append((time.thread_time() - begin) / n)
        found[f"our walkers, {n} together"] = least(together)
        found[f"of which Box2D, {n} together"] = least(alone)
    return found


def least(seconds: list[float]) -> float:
    """Microseconds: the lower tenth, which other processes on the machine disturb least."""
    return float(np.quantile(seconds, 0.1)) * 1e6


# ---- rates -----------------------------------------------------------------------------------


def sb3_rate(seconds: float, barrier: Any) -> float:
    """Steps per second of processor time of one process."""
    return rates.of_sb3(sb3_model(0), seconds, barrier)


def our_rate(engine: str, seconds: float, barrier: Any) -> float:
    """Likewise, of the default preset, with few evaluations on the way."""
    os.environ["NPROC"] = "1"
    from mbtl.cmdps import get_cmdp

    trainer = get_cmdp("walker-gravity", engine=engine).trainer
    world, params = trainer.problem([NOMINAL])
    every = 10 * trainer.update_length
    return rates.of_engine(world, trainer.learner, [0], params, every, seconds, barrier)


# ---- learning --------------------------------------------------------------------------------


def our_learning(seed: int, steps: int) -> list[tuple[int, float, float]]:
    """(steps, processor seconds, mean return of the latest policy in Box2D) on the way."""
    import mbtl.training.jax as engine
    from mbtl.checkpoints import Checkpoint
    from mbtl.cmdps import get_cmdp

    trainer = get_cmdp("walker-gravity", engine="jax").trainer
    judge = get_cmdp("walker-gravity", engine="gymnasium-jax").trainer_for(eval_episodes=EPISODES)
    world, params = trainer.problem([NOMINAL])
    begin, found = time.process_time(), []

    def on_block(block: engine.Block) -> None:
        now = time.process_time() - begin
        latest = engine.weights_of(block.training, Checkpoint.named("final"), ())
        (policy,) = engine.export_policies(world, latest, trainer.learner.activation)
        found.append((block.steps, now, float(judge.evaluate(policy, [NOMINAL], seed).mean())))
        print(
            f"  ours, seed {seed}: {block.steps} steps, {now:.0f} s, {found[-1][2]:.0f}", flush=True
        )

    engine.train(
        world, trainer.learner, [seed], params, steps,
        checkpoint_every=steps // 10, checkpoint_episodes=EPISODES, on_block=on_block,
    )  # fmt: skip
    return found


def sb3_learning(seed: int, steps: int) -> list[tuple[int, float, float]]:
    """Likewise."""
    model, env = sb3_model(seed), gymnasium_walker()
    begin, found = time.process_time(), []
    for _ in range(10):
        model.learn(steps // 10, reset_num_timesteps=False)
        now, returns = time.process_time() - begin, []
        for episode in range(EPISODES):
            seen, over, total = env.reset(seed=10_000 + episode)[0], False, 0.0
            while not over:
                action, _ = model.predict(seen, deterministic=True)
                seen, reward, ended, out, _ = env.step(action)
                total, over = total + float(reward), ended or out
            returns.append(total)
        found.append((model.num_timesteps, now, float(np.mean(returns))))
        line = f"{found[-1][0]} steps, {now:.0f} s, {found[-1][2]:.0f}"
        print(f"  Stable-Baselines3, seed {seed}: {line}", flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = ("step", "rate", "learning")
    parser.add_argument("--part", nargs="+", choices=parts, default=list(parts))
    parser.add_argument("--seconds", type=float, default=60.0, help="of a rate")
    parser.add_argument("--steps", type=int, default=1_000_000, help="of a training")
    parser.add_argument("--seeds", type=int, default=1, help="trainings of each")
    args = parser.parse_args()
    if "step" in args.part:
        costs = step_costs()
        theirs = costs["Gymnasium's BipedalWalker"]
        for name, cost in costs.items():
            print(f"{name:32s} {cost:6.1f} us a step, {theirs / cost:4.1f} x", flush=True)
    if "rate" in args.part:
        theirs = sum(on_every_core(sb3_rate, args.seconds))
        print(
            f"training steps per second on {CORES} cores: Stable-Baselines3 {theirs:.0f}",
            flush=True,
        )
        for name, engine in (("ours, Box2D", "gymnasium-jax"), ("ours, in jax", "jax")):
            rate = sum(on_every_core(our_rate, engine, args.seconds))
            print(f"{name}: {rate:.0f}, {rate / theirs:.1f} x", flush=True)
    if "learning" in args.part:
        for seed, work in ((s, w) for s in range(args.seeds) for w in (our_learning, sb3_learning)):
            functools.partial(work, seed, args.steps)()


if __name__ == "__main__":
    main()
