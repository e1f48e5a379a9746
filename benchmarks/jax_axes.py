"""Simulators in jax of others, their parameters as axes: what acts, what is learnt, how fast.

    python benchmarks/jax_axes.py [--only NAME ...] [--steps 500000] [--contexts 8]

Per environment: which axes change a seeded rollout (`mbtl check`); returns of random actions, and
of a policy after --steps in one context; and training steps per second of processor time, learning
and all else included, of one context and of --contexts at once. The peer is Brax's own PPO with the
same copies, rollouts, minibatches, epochs and networks; gymnax has no trainer, so its peer is the
bare stepping of as many copies as one policy has, with random actions and its own auto-reset.
Needs gymnax, brax and playground; what is missing is left out. Brax 0.14.2 calls
`jax.device_put_replicated`, which jax 0.10 has removed, so its PPO is lent one here.
"""

from __future__ import annotations

import measure  # first: threads

import argparse  # isort: skip
import time
import warnings
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any

import rates

import mbtl
from mbtl.engine import jax_problem
from mbtl.problems import check_cmdp
from mbtl.trainers import reference_rows

COPIES, ROLLOUT, MINIBATCH = 64, 16, 128
RECIPE = {"n_envs": COPIES, "n_steps": ROLLOUT, "batch_size": MINIBATCH, "learning_rate": 1e-3}
GRAVITY = mbtl.Linear("gravity[2]", -15.0, -5.0, "m/s2")


def gymnax_env(name: str) -> tuple[Any, Any]:
    import gymnax

    made: tuple[Any, Any] = gymnax.make(name)
    return made


def brax_env(name: str) -> tuple[Any, Any]:
    from brax import envs

    return envs.get_environment(name, backend="spring"), None


def playground_env(name: str) -> tuple[Any, Any]:
    from mujoco_playground import registry

    return registry.load(name, config_overrides={"impl": "jax"}), None


ENVIRONMENTS: dict[str, tuple[str, Callable[[], tuple[Any, Any]], list[Any]]] = {
    "Pendulum-v1": (
        "gymnax",
        partial(gymnax_env, "Pendulum-v1"),
        [mbtl.Linear("g", 5.0, 15.0, "m/s2"), mbtl.Linear("l", 0.5, 1.5, "m")],
    ),
    "CartPole-v1": (
        "gymnax",
        partial(gymnax_env, "CartPole-v1"),
        [mbtl.Linear("length", 0.2, 2.0, "m"), mbtl.Linear("force_mag", 5.0, 15.0, "N")],
    ),
    "inverted_pendulum": (
        "brax",
        partial(brax_env, "inverted_pendulum"),
        [GRAVITY, mbtl.Linear("link.inertia.mass[1]", 1.0, 10.0, "kg")],
    ),
    "ant": (
        "brax",
        partial(brax_env, "ant"),
        [GRAVITY, mbtl.Linear("actuator.gear", 50.0, 300.0, "N m")],
    ),
    "CartpoleBalance": (
        "mujoco_playground",
        partial(playground_env, "CartpoleBalance"),
        [mbtl.Linear("opt.gravity[2]", -15.0, -5.0), mbtl.Linear("body_mass[2]", 0.05, 0.5, "kg")],
    ),
}


def our_rate(problem: Any, contexts: int, seconds: float) -> float:
    world, params = problem.trainer.problem([problem.space.context(i) for i in range(contexts)])
    alone = SimpleNamespace(wait=lambda: None)
    every = 64 * COPIES * ROLLOUT  # an evaluation of one episode is less than 2 % of it
    recipe = problem.trainer.learner
    return contexts * rates.of_engine(world, recipe, range(contexts), params, every, seconds, alone)


def brax_rate(env: Any, horizon: int, steps: int) -> float:
    """Training steps per second of Brax's PPO after its first, compiling epoch."""
    import jax
    from brax.training.agents.ppo import networks, train

    def replicated(tree: Any, devices: Any) -> Any:
        return jax.tree.map(lambda x: jax.numpy.stack([x] * len(devices)), tree)

    if not hasattr(jax, "device_put_replicated"):
        jax.device_put_replicated = replicated
    wrapped = {}
    if not hasattr(env, "sys"):
        from mujoco_playground import wrapper

        wrapped = {"wrap_env_fn": wrapper.wrap_for_brax_training}
    marks: list[tuple[int, float]] = []
    hidden = (64, 64)
    train.train(
        env, steps, num_envs=COPIES, episode_length=horizon, unroll_length=ROLLOUT,
        batch_size=MINIBATCH // ROLLOUT, num_minibatches=COPIES * ROLLOUT // MINIBATCH,
        num_updates_per_batch=1, learning_rate=1e-3, discounting=0.99, num_evals=3, run_evals=False,
        progress_fn=lambda count, _: marks.append((count, time.process_time())),
        network_factory=partial(
            networks.make_ppo_networks,
            policy_hidden_layer_sizes=hidden, value_hidden_layer_sizes=hidden,
        ),
        **wrapped,
    )  # fmt: skip
    (first, begin), (last, end) = marks[-2:]
    return (last - first) / (end - begin)


def gymnax_rate(env: Any, params: Any, seconds: float) -> float:
    """Steps per second of copies with random actions, and nothing else."""
    import jax

    space = env.action_space(params)

    @jax.jit
    def thousand(states: Any, key: Any) -> Any:
        def one(states: Any, key: Any) -> Any:
            keys = jax.random.split(key, 2 * COPIES)
            actions = jax.vmap(space.sample)(keys[:COPIES])
            _, states, reward, *_ = jax.vmap(env.step, (0, 0, 0, None))(
                keys[COPIES:], states, actions, params
            )
            return states, reward.sum()

        return jax.lax.scan(one, states, jax.random.split(key, 1000))

    keys = jax.random.split(jax.random.PRNGKey(0), COPIES)
    states = jax.vmap(env.reset, (0, None))(keys, params)[1]
    states = jax.block_until_ready(thousand(states, keys[0]))[0]
    begin, wall, steps = time.process_time(), time.perf_counter(), 0
    while time.perf_counter() - wall < seconds:
        states = jax.block_until_ready(thousand(states, keys[0]))[0]
        steps += 1000 * COPIES
    return steps / (time.process_time() - begin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=ENVIRONMENTS, default=list(ENVIRONMENTS))
    parser.add_argument("--steps", type=int, default=500_000, help="of the training looked at")
    parser.add_argument("--contexts", type=int, default=8, help="trained at once")
    parser.add_argument("--seconds", type=float, default=10.0, help="per rate")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    print(measure.machine("jax", "gymnax", "brax", "playground", "mujoco-mjx"))
    for name in args.only:
        package, make, axes = ENVIRONMENTS[name]
        if find_spec(package) is None:
            print(f"{name}: needs {package}")
            continue
        env, params = make()
        n = -(-args.contexts // 2)
        space = mbtl.ContextSpace.grid({axes[0]: n, axes[1]: 2})
        problem = jax_problem(
            name, env, params, space, timesteps=args.steps,
            trainer_options={"hyperparameters": RECIPE},
        )  # fmt: skip
        checks = check_cmdp(problem, steps=50).checks
        acting = {c.name.split("'")[1]: c.outcome for c in checks if c.name.startswith("axis")}
        trainer, home = problem.trainer, [space.context(space.n // 2)]
        random = reference_rows(trainer, home, [0])["random_actions"].mean()
        policy = trainer.train(home, 0).policy
        trained = trainer.evaluate(policy, home, [0]).mean()
        one, many = (our_rate(problem, k, args.seconds) for k in (1, args.contexts))
        print(
            f"{name}: axes {acting}; return {random:.1f} at random, {trained:.1f} after "
            f"{args.steps:,} steps; steps/s {one:,.0f} in one context, {many:,.0f} in "
            f"{args.contexts}",
            flush=True,
        )
        if package == "gymnax":
            peer, whose = gymnax_rate(env, params, args.seconds), "gymnax stepping alone"
        else:
            peer, whose = brax_rate(env, problem.horizon, args.steps), "Brax's PPO"
        print(f"  {whose} {peer:,.0f}: ratios {one / peer:.2f}, {many / peer:.2f}", flush=True)


if __name__ == "__main__":
    main()
