"""Trainings in one program: what a step costs with one policy and with several, in one run.

A native simulator is called once per step for all policies and copies, and what a call costs beside
the simulation, it costs once. Rounds of each are taken in turns, so that what else runs on the
machine disturbs all alike; printed are medians of processor time.

example: python benchmarks/lanes.py walker-gravity --lanes 1 5
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import measure
from measure import cost_of, digits, note

os.environ["NPROC"] = "1"  # threads of the simulator, read when it is made


def updates(id: str, lanes: int) -> tuple[Callable[[int], None], int]:
    """Learns for some updates more, and the environment steps of one, of all policies together."""
    import jax
    import jax.numpy as jnp

    import mbtl.engine.learners as engine
    from mbtl.engine.learners import algorithms
    from mbtl.engine.learners.clock import Pace, clock_at
    from mbtl.problems import get_cmdp

    cmdp = get_cmdp(id)
    trainer: Any = cmdp.trainer
    world, params = trainer.problem([dict(cmdp.nominal or {})] * lanes)
    params, recipe = jax.tree.map(jnp.asarray, params), trainer.learner
    decisions = world.decisions(params)
    state = engine.start(world, recipe, list(range(lanes)), params).state

    @jax.jit
    def one(state: Any, params: Any, number: Any) -> Any:
        clock = clock_at(number, Pace.falling(1000))
        return algorithms.update(world, recipe, decisions, state, params, clock)

    done = 0

    def go(count: int) -> None:
        nonlocal state, done
        for _ in range(count):
            state, done = one(state, params, jnp.int32(done)), done + 1
        jax.block_until_ready(state)

    return go, lanes * trainer.update_length


def main() -> None:
    """Print a line per number of policies."""
    parser = measure.parser(__doc__)
    parser.add_argument("cmdp", help="one whose simulator is native, e.g. walker-gravity")
    parser.add_argument("--lanes", type=int, nargs="+", default=[1, 5], help="policies together")
    parser.add_argument("--rounds", type=int, default=5, help="of each, in turns (default 5)")
    parser.add_argument("--steps", type=int, default=20_000, help="of a round, all policies'")
    args = parser.parse_args()
    taken: dict[int, list[float]] = {lanes: [] for lanes in args.lanes}
    ready = {}
    for lanes in args.lanes:
        note(f"compiling for {lanes} ...")
        ready[lanes] = updates(args.cmdp, lanes)
        ready[lanes][0](1)
    for _ in range(args.rounds):
        for lanes, (go, steps) in ready.items():
            count = max(1, args.steps // steps)
            taken[lanes].append(cost_of(partial(go, count)).cpu / (count * steps))
    cost = {lanes: median(each) * 1e6 for lanes, each in taken.items()}
    first = cost[args.lanes[0]]
    lines = [
        f"{lanes} together: {x:.0f} us of processor time a step, {first / x:.2f} x as fast"
        for lanes, x in cost.items()
    ]
    versions = measure.machine("mujoco", "jax")
    case = {"cmdp": args.cmdp, "us_per_step": {str(k): digits(x) for k, x in cost.items()}}
    measure.show({"machine": versions, "case": case}, lines, as_json=args.json)


if __name__ == "__main__":
    main()
