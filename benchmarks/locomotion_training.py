"""HalfCheetah: training in batches against Stable-Baselines3, on one core in one run.

Per seed one policy of each is trained in the nominal context for the same number of steps: our
preset, with its checkpoints, and Stable-Baselines3's default PPO on Gymnasium's HalfCheetah-v5
(without evaluations, so it is charged for less). Both are then played in Gymnasium's environment.
What is compiled once per process is counted apart, as a matrix or a study pays it once. `--physics`
only steps the simulators, without any policy: ours, `mujoco.rollout`, Gymnasium's, and MuJoCo in a
bare loop.

example: python benchmarks/locomotion_training.py --steps 300000 --seeds 2
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import measure
from measure import Cost, cost_of, digits, mean, note

os.environ["NPROC"] = "1"  # threads of the simulator, read when it is made

CONTEXT = {"gravity": 9.81}
EPISODES = 10


def ours(steps: int, seed: int) -> tuple[Any, Cost]:
    """A policy by our preset."""
    from mbtl.problems import get_cmdp

    trainer = get_cmdp("cheetah-gravity", visibility="hidden").trainer_for(timesteps=steps)
    found: list[Any] = []
    cost = cost_of(lambda: found.append(trainer.train([CONTEXT], seed).policy))
    return found[0], cost


def theirs(steps: int, seed: int) -> tuple[Any, Cost]:
    """A policy by Stable-Baselines3."""
    import gymnasium
    import torch
    from stable_baselines3 import PPO

    torch.set_num_threads(1)
    env = gymnasium.make("HalfCheetah-v5")
    model = PPO("MlpPolicy", env, seed=seed, device="cpu")
    return model, cost_of(lambda: model.learn(steps))


def score(policy: Any) -> float:
    """Mean return in Gymnasium's environment, without sampling."""
    import gymnasium
    import numpy as np

    env, total = gymnasium.make("HalfCheetah-v5"), 0.0
    for episode in range(EPISODES):
        observation, over = env.reset(seed=episode)[0], False
        while not over:
            action = policy.predict(np.float32(observation)[None], deterministic=True)[0][0]
            observation, reward, terminated, truncated, _ = env.step(action)
            total += float(reward)
            over = terminated or truncated
    return total / EPISODES


def compared(steps: int, seeds: int) -> dict[str, Any]:
    """Both trainers, in turn."""
    note("compiling ...")
    once = cost_of(lambda: ours(1, 0))
    makers: dict[str, Callable[[int, int], tuple[Any, Cost]]] = {"ours": ours, "theirs": theirs}
    costs: dict[str, list[Cost]] = {name: [] for name in makers}
    returns: dict[str, list[float]] = {name: [] for name in makers}
    for seed in range(1, seeds + 1):
        for name, make in makers.items():
            policy, cost = make(steps, seed)
            costs[name].append(cost)
            returns[name].append(score(policy))
            note(f"seed {seed}, {name}: {steps / cost.cpu:.0f} steps/s, {returns[name][-1]:.0f}")
    per_second = {name: steps / mean(each).cpu for name, each in costs.items()}
    mean_return = {name: sum(each) / seeds for name, each in returns.items()}
    per_hour = {name: mean_return[name] / mean(costs[name]).cpu * 3600 for name in makers}
    return {
        "steps": steps,
        "compiled_once_seconds": once.to_json(),
        "steps_per_cpu_second": {name: digits(x) for name, x in per_second.items()},
        "ratio": digits(per_second["ours"] / per_second["theirs"], 3),
        "returns": {name: [digits(x) for x in each] for name, each in returns.items()},
        "return_per_cpu_hour": {name: digits(x) for name, x in per_hour.items()},
        "ratio_of_returns": digits(mean_return["ours"] / mean_return["theirs"], 3),
    }


def stepped(copies: int, steps: int) -> dict[str, Any]:
    """Control steps per second of processor time under random actions, nothing else."""
    import gymnasium
    import mujoco
    import numpy as np

    from mbtl.zoo.cmdps.locomotion.cheetah import HalfCheetah, new_model
    from mbtl.zoo.cmdps.locomotion.cheetah_batch import CheetahParams, HalfCheetahs

    batch, rng = HalfCheetahs(), np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (steps // copies, copies, 6)).astype(np.float32)
    params = CheetahParams(*(np.full(copies, x) for x in HalfCheetah().constants), ())
    state: Any = {"physics": np.zeros((copies, 26), np.float32)}

    def in_batches() -> None:
        nonlocal state
        for action in actions:
            state = batch.step(state, action, params)[0]

    def one_by_one(env: Any) -> Callable[[], None]:
        env.reset(seed=0)

        def run() -> None:
            for action in actions.reshape(-1, 6):
                if env.step(action)[3]:
                    env.reset()

        return run

    def by_rollout() -> None:
        from mujoco.rollout import Rollout

        models = [new_model() for _ in range(copies)]
        size = mujoco.mj_stateSize(models[0], mujoco.mjtState.mjSTATE_FULLPHYSICS)
        data = [mujoco.MjData(models[0])]  # of one thread
        now, every = np.zeros((copies, size)), np.zeros((copies, 5, size))
        with Rollout(nthread=0) as rollout:
            for action in actions.astype(np.float64):
                held = np.repeat(action[:, None], 5, axis=1)
                rollout.rollout(models, data, now, held, nstep=5, state=every, skip_checks=True)
                now = every[:, -1].copy()

    def bare() -> None:
        env = HalfCheetah()
        for action in actions.reshape(-1, 6):
            env.data.ctrl[:] = action
            mujoco.mj_step(env.model, env.data, nstep=5)

    each = {
        f"ours, {copies} at once": in_batches,
        "mujoco.rollout, as many": by_rollout,
        "our environment": one_by_one(HalfCheetah(visibility="hidden")),
        "Gymnasium": one_by_one(gymnasium.make("HalfCheetah-v5")),
        "MuJoCo in a loop": bare,
    }
    return {name: digits(steps / cost_of(work).cpu) for name, work in each.items()}


def main() -> None:
    """Print a line per figure."""
    parser = measure.parser(__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000, help="of a training")
    parser.add_argument("--seeds", type=int, default=3, help="trainings of each (default 3)")
    parser.add_argument("--physics", action="store_true", help="only step the simulators")
    parser.add_argument("--copies", type=int, default=32, help="of --physics (default 32)")
    args = parser.parse_args()
    if args.physics:
        case = stepped(args.copies, min(args.steps, 20_000))
    else:
        case = compared(args.steps, args.seeds)
    versions = measure.machine("mujoco", "gymnasium", "stable-baselines3", "torch", "jax")
    document = {"machine": versions, "case": case}
    measure.show(document, [f"{k}: {v}" for k, v in case.items()], as_json=args.json)


if __name__ == "__main__":
    main()
