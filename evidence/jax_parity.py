"""Do PPO, A2C and DQN in jax learn as Stable-Baselines3's do? Same environment, recipe and seeds.

    .venv/bin/python evidence/jax_parity.py [--algorithm PPO] [--cmdp cartpole] [--seeds 10]
        [--steps 50000]

At five checkpoints the latest policy of each seed plays 20 deterministic episodes. Printed: means,
their difference and its 90 % interval (Welch), in raw returns and as a share of the CMDP's bounds.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np
from scipy import stats

from mbtl.processes import usable_cores
from mbtl.zoo.cmdps import cartpole, pendulum

CHECKPOINTS, EPISODES = 5, 20
GYM = {"cartpole": (cartpole, cartpole.CartPole), "pendulum": (pendulum, pendulum.Pendulum)}
CONTEXT = {"cartpole": {"length": 0.5}, "pendulum": {"mass": 1.0}}
BOUNDS = {"cartpole": (0.0, 500.0), "pendulum": (-2200.0, -500.0)}


def sb3_curve(algorithm: str, name: str, every: int, seed: int) -> list[float]:
    """Mean return at each checkpoint."""
    import stable_baselines3
    import torch
    from stable_baselines3.common.callbacks import BaseCallback

    from mbtl.envs.rollout import Job, play
    from mbtl.trainers.sb3_learning import actor_for

    torch.set_num_threads(1)
    make = partial(GYM[name][1], CONTEXT[name])
    replay = {"buffer_size": 100_000} if algorithm == "DQN" else {}
    kind = getattr(stable_baselines3, algorithm)
    model = kind("MlpPolicy", make(), seed=seed, device="cpu", **replay)
    curve: list[float] = []

    def look() -> None:
        (returns,) = play([Job(make, range(EPISODES))], actor_for(model), max_envs=1)
        curve.append(float(np.mean(returns)))

    class Look(BaseCallback):
        def _on_rollout_start(self) -> None:  # what came before has been learnt from
            if self.num_timesteps == (len(curve) + 1) * every:
                look()

        def _on_step(self) -> bool:
            return True

    model.learn(CHECKPOINTS * every, callback=Look())
    look()
    return curve


def jax_curves(algorithm: str, name: str, every: int, seeds: int) -> np.ndarray:
    """(seeds, checkpoints) mean returns."""
    import mbtl.engine.learners as engine
    from mbtl.engine import worlds
    from mbtl.zoo.worlds import CartPole, Pendulum

    module, gym_class = GYM[name]
    env = worlds.Solo({"cartpole": CartPole, "pendulum": Pendulum}[name]())
    there = gym_class(CONTEXT[name])
    constants = [module.derive(there.features)]
    one = worlds.stack_params(env, constants, [there.visible])
    params = worlds.stack_params(env, constants * seeds, [there.visible] * seeds)
    curves = []
    recipe = engine.recipe_named(algorithm, "sb3")

    def look(block: engine.Block) -> None:
        actor = engine.actor_of(block.training.state.weights)
        returns = engine.evaluate(env, actor, one, [range(EPISODES)], activation=recipe.activation)
        curves.append(returns.mean(axis=(1, 2)))

    engine.train(
        env, recipe, range(seeds), params, CHECKPOINTS * every,
        checkpoint_every=every, checkpoint_episodes=1, on_block=look,
    )  # fmt: skip
    return np.stack(curves, axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--algorithm", choices=["PPO", "A2C", "DQN"], default="PPO")
    parser.add_argument("--cmdp", choices=sorted(GYM), default="cartpole")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--steps", type=int, default=50_000)
    args = parser.parse_args()
    import mbtl.engine.learners as engine  # here: the other processes need no jax

    update = engine.recipe_named(args.algorithm, "sb3").update_length
    every = update * max(1, round(args.steps / CHECKPOINTS / update))
    ours = jax_curves(args.algorithm, args.cmdp, every, args.seeds)
    cores = usable_cores()
    with ProcessPoolExecutor(cores, mp_context=get_context("spawn")) as pool:
        one = partial(sb3_curve, args.algorithm, args.cmdp, every)
        theirs = np.array(list(pool.map(one, range(args.seeds))))
    low, high = BOUNDS[args.cmdp]
    print(f"{args.algorithm} on {args.cmdp}, {args.seeds} seeds each, recipe sb3")
    print("   steps       jax       SB3   difference   90 % interval   of the bounds")
    for k in range(CHECKPOINTS):
        a, b = ours[:, k], theirs[:, k]
        if np.ptp(a) == np.ptp(b) == 0.0:
            less = more = a.mean() - b.mean()
        else:
            less, more = stats.ttest_ind(a, b, equal_var=False).confidence_interval(0.9)
        share = 100.0 / (high - low)
        print(
            f"{(k + 1) * every:8,d}  {a.mean():8.1f}  {b.mean():8.1f}  {a.mean() - b.mean():11.1f}"
            f"  [{less:6.1f}, {more:6.1f}]  [{less * share:+.1f} %, {more * share:+.1f} %]"
        )


if __name__ == "__main__":
    main()
