"""BipedalWalker in jax: a step, and what training gives, beside Stable-Baselines3.

    python benchmarks/walker_training.py [--part PARTS] [--steps 1000000] [--seeds 3]

`twin` is a step of 160 walkers in jax, without networks, and how long it is compiled.
`rate` trains for --seconds on every core at once, one process each: Stable-Baselines3 with its
default PPO on Gymnasium's environment, and the recipe of the CMDP in the engine. Rates are steps
per second of processor time, added up over cores, with learning and all else.
`learning` trains --who in the nominal context for as many --steps: `ours`, the recipe of the CMDP
with the walker in jax; `same`, Stable-Baselines3's PPO with that recipe on Gymnasium's environment;
and `default`, its PPO with its defaults. It prints, --looks times on the way, what policies return
in Gymnasium's environment (mean actions, the same ten fresh episodes of 1000 steps) and the seconds
of processor time that the trainings took, with compiling, without these looks. Ours is extended
from look to look, and it prints what the policies return where they were trained, too, in other
episodes. Trainings of the same kind take turns, so that an interrupted run has equal steps of all.
"""

from __future__ import annotations

import measure  # noqa: F401  first: threads

import argparse  # isort: skip
import os
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import rates
from rates import CORES, on_every_core

HORIZON, EPISODES = 1000, 10
NOMINAL = {"gravity": 10.0}
WHO = ("ours", "same", "default")


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


def twin_costs(n: int = 160, steps: int = 40) -> tuple[float, float]:
    """Of n walkers in jax: microseconds of processor time of a step, and seconds of compiling."""
    os.environ.update(NPROC="1", JAX_ENABLE_COMPILATION_CACHE="false")
    import mbtl.engine.worlds as worlds
    from mbtl.zoo.worlds.walker import BipedalWalker, WalkerParams

    import jax  # isort: skip  # after mbtl, which sets its flags
    import jax.numpy as jnp  # isort: skip

    world, rng = worlds.Solo(BipedalWalker()), np.random.default_rng(0)
    own = WalkerParams(*(jnp.full(n, x) for x in (10.0, 2.5, 30.0)), jnp.zeros((n, 0)))
    action = jnp.asarray(rng.uniform(-1.0, 1.0, (n, 1, 4)), jnp.float32)
    state = world.start(jnp.asarray(rng.random((n, 2)), jnp.float32), own)

    def together(state: Any, count: Any) -> Any:
        def one(_: Any, now: Any) -> Any:
            return world.step(now, action, own).state

        return jax.lax.fori_loop(0, count, one, state)

    begin = time.process_time()
    compiled = jax.jit(together).lower(state, 1).compile()
    compiling, costs = time.process_time() - begin, []
    for _ in range(5):
        begin = time.process_time()
        jax.block_until_ready(compiled(state, steps))
        costs.append((time.process_time() - begin) / steps / n)
    return min(costs) * 1e6, compiling


# ---- rates -----------------------------------------------------------------------------------


def sb3_rate(seconds: float, barrier: Any) -> float:
    """Steps per second of processor time of one process."""
    return rates.of_sb3(sb3_model(0), seconds, barrier)


def our_rate(seconds: float, barrier: Any) -> float:
    """Likewise, of the default preset, with few evaluations on the way."""
    os.environ["NPROC"] = "1"
    from mbtl.problems import get_cmdp

    trainer = get_cmdp("walker-gravity", engine="jax").trainer
    world, params = trainer.problem([NOMINAL])
    every = 10 * trainer.update_length
    return rates.of_engine(world, trainer.learner, [0], params, every, seconds, barrier)


# ---- learning --------------------------------------------------------------------------------


Look = tuple[int, float, dict[str, float]]
"""Steps so far, seconds of processor time that they took, mean returns by policy and simulator."""


def looks_of(recipe: Any, steps: int, looks: int) -> tuple[int, int]:
    """Steps of a whole training and between two looks, in whole updates of our recipe."""
    every = steps // looks // recipe.update_length * recipe.update_length
    return every * looks, every


def judged(policy: Any, shown: Any = ()) -> float:
    """Mean return in Gymnasium's environment, of the same episodes for all.

    `shown` is what the policy sees of its context.
    """
    env, returns = gymnasium_walker(), []
    for episode in range(EPISODES):
        seen, over, total = env.reset(seed=10_000 + episode)[0], False, 0.0
        while not over:
            action, _ = policy.predict(np.append(seen, shown), deterministic=True)
            seen, reward, ended, out, _ = env.step(action)
            total, over = total + float(reward), ended or out
        returns.append(total)
    return float(np.mean(returns))


def our_learning(seed: int, steps: int, looks: int) -> Iterator[Look]:
    """Of the engine: one training that goes on."""
    os.environ["NPROC"] = "1"
    from mbtl.problems import get_cmdp

    trainer: Any = get_cmdp("walker-gravity", engine="jax").trainer
    total, every = looks_of(trainer.learner, steps, looks)
    (shown,) = trainer.problem([NOMINAL])[1].visible
    policy, spent = None, 0.0
    with TemporaryDirectory() as folder:
        for done in range(every, total + 1, every):
            begin = time.process_time()
            policy = trainer.train(
                [NOMINAL], seed, start=policy, length=done / trainer.whole,
                done=(done - every) / trainer.whole, state=Path(folder) / "state",
            ).policy  # fmt: skip
            spent += time.process_time() - begin
            yield done, spent, {
                "latest": judged(policy, shown),
                "latest, at home": float(trainer.evaluate(policy, [NOMINAL], [0]).mean()),
            }  # fmt: skip


def sb3_learning(same: bool, seed: int, steps: int, looks: int) -> Iterator[Look]:
    """Of Stable-Baselines3, with our recipe or its own."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env
    from torch import nn

    from mbtl.problems import get_cmdp

    torch.set_num_threads(1)
    recipe = get_cmdp("walker-gravity", engine="jax").trainer.learner
    total, every = looks_of(recipe, steps, looks)
    if same:
        assert (recipe.activation, recipe.standardize) == ("tanh", False)
        model = PPO(
            "MlpPolicy", make_vec_env(gymnasium_walker, recipe.n_envs, seed=seed), device="cpu",
            seed=seed, n_steps=recipe.n_steps, batch_size=recipe.batch_size,
            n_epochs=recipe.n_epochs, gamma=recipe.gamma, gae_lambda=recipe.gae_lambda,
            clip_range=recipe.clip_range, ent_coef=recipe.entropy_coef, vf_coef=recipe.value_coef,
            max_grad_norm=recipe.max_grad_norm, normalize_advantage=recipe.normalize_advantage,
            learning_rate=recipe.learning_rate,
            policy_kwargs={
                "net_arch": list(recipe.hidden), "activation_fn": nn.Tanh,
                "log_std_init": recipe.log_std, "optimizer_kwargs": {"eps": recipe.adam_eps},
            },
        )  # fmt: skip
        if recipe.anneal:  # over the whole training, of which `learn` knows a part at a time
            left = total + recipe.update_length
            model.lr_schedule = lambda _: (
                recipe.learning_rate * (left - model.num_timesteps) / total
            )
    else:
        model = sb3_model(seed)
    spent = 0.0
    for done in range(every, total + 1, every):
        begin = time.process_time()
        model.learn(every, reset_num_timesteps=False)
        spent += time.process_time() - begin
        assert model.num_timesteps == done
        yield done, spent, {"latest": judged(model)}


def learning(who: str, seeds: range, steps: int, looks: int) -> None:
    """Prints a line per look: steps, mean return and seconds of each seed."""
    made = {
        "ours": our_learning,
        "same": partial(sb3_learning, True),
        "default": partial(sb3_learning, False),
    }[who]
    print(f"{who}: steps, policy; returns by seed, mean; processor seconds of all", flush=True)
    for together in zip(*(made(seed, steps, looks) for seed in seeds), strict=True):
        spent = sum(look[1] for look in together)
        for name in together[0][2]:
            returns = [look[2][name] for look in together]
            each = " ".join(f"{x:7.1f}" for x in returns)
            mean = np.mean(returns)
            print(f"{together[0][0]:8d}, {name:15s}; {each}, {mean:7.1f}; {spent:6.0f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = ("twin", "rate", "learning")
    parser.add_argument("--part", nargs="+", choices=parts, default=list(parts))
    parser.add_argument("--seconds", type=float, default=60.0, help="of a rate")
    parser.add_argument("--who", nargs="+", choices=WHO, default=list(WHO), help="that learn")
    parser.add_argument("--steps", type=int, default=1_000_000, help="of a training")
    parser.add_argument("--looks", type=int, default=10, help="at a training")
    parser.add_argument("--seeds", type=int, default=3, help="trainings of each")
    parser.add_argument("--first-seed", type=int, default=0, help="of the trainings")
    args = parser.parse_args()
    if "twin" in args.part:
        cost, compiling = twin_costs()
        print(
            f"in jax, 160 together: {cost:.1f} us a step, compiled in {compiling:.0f} s", flush=True
        )
    if "rate" in args.part:
        theirs = sum(on_every_core(sb3_rate, args.seconds))
        print(
            f"training steps per second on {CORES} cores: Stable-Baselines3 {theirs:.0f}",
            flush=True,
        )
        ours = sum(on_every_core(our_rate, args.seconds))
        print(f"ours: {ours:.0f}, {ours / theirs:.1f} x", flush=True)
    if "learning" in args.part:
        for who in args.who:
            seeds = range(args.first_seed, args.first_seed + args.seeds)
            learning(who, seeds, args.steps, args.looks)


if __name__ == "__main__":
    main()
