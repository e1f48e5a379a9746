"""How a training of eco-driving in its twin divides: cars, networks, what is kept, learning.

One update of many policies, one program: the same episodes are played without advice, by the
policies, and by the policies with everything kept that they learn from; then the whole update. Each
part is the difference to the one before, so it includes what new policies do to the traffic.
Processor time of one thread; the first call of each, which compiles, is not counted.

example: taskset -c 0 python benchmarks/twin_time.py --policies 25
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import measure
from measure import cost_of, digits, note

CASES = ("eco-inflow standard",)
PARTS = ("cars", "networks", "keeping", "learning")


def division(id: str, preset: str, policies: int, rounds: int) -> dict[str, Any]:
    """Shares of one update's processor time, and its decisions per second."""
    import mbtl.engine.learners  # noqa: F401  isort: skip  # first: flags of jax
    import jax
    import jax.numpy as jnp
    import numpy as np

    from mbtl.engine.learners import algorithms
    from mbtl.engine.learners.clock import Pace, clock_at
    from mbtl.engine.learners.episodic.episodes import actor_of, measures, record
    from mbtl.engine.worlds.world import of_simulations
    from mbtl.problems import get_cmdp

    cmdp = get_cmdp(id, engine="jax")
    trainer: Any = cmdp.trainer_for(preset)
    every_nth = len(cmdp.space.contexts) // policies
    world, params = trainer._lessons(cmdp.space.contexts[::every_nth][:policies])
    recipe, length = trainer.learner, world.decisions(params)
    params = jax.tree.map(jnp.asarray, params)
    begun = algorithms.init(world, recipe, list(range(policies)), params)
    seeds = jnp.arange(policies * recipe.n_episodes, dtype=jnp.uint32).reshape(policies, -1)
    every = of_simulations(params, recipe.n_episodes)

    @partial(jax.jit, static_argnums=0)
    def played(how: str, state: Any, params: Any) -> Any:
        actor = actor_of(state.weights)
        return measures(world, recipe.activation, how, actor, seeds, seeds, params, length)["score"]

    @jax.jit
    def kept(state: Any, params: Any) -> Any:
        actor = actor_of(state.weights)
        return record(world, recipe.activation, length, actor, seeds, params, recipe.hold)

    @jax.jit
    def learnt(state: Any, params: Any) -> Any:
        clock = clock_at(jnp.int32(0), Pace.falling(10))
        return algorithms.update(world, recipe, length, state, params, clock)

    def least(work: Callable[..., Any], params: Any) -> float:
        def call() -> None:
            jax.block_until_ready(work(begun, params))

        call()
        return min(cost_of(call).cpu for _ in range(rounds))

    steps = [partial(played, "none"), partial(played, "sampled"), kept]
    ends = [least(step, every) for step in steps] + [least(learnt, params)]
    parts = np.diff([0.0, *ends])
    decisions = seeds.size * int(length)
    share = {name: x / ends[-1] for name, x in zip(PARTS, parts, strict=True)}
    rate = decisions / ends[-1]
    return {
        "case": f"{id}, {preset}, {policies} policies",
        "decisions_per_second": digits(rate, 3),
        "share": {name: digits(part, 2) for name, part in share.items()},
    }


def main() -> None:
    """Print a line per case."""
    parser = measure.parser(__doc__)
    parser.add_argument("--cases", nargs="+", default=list(CASES), help="CMDP and preset each")
    parser.add_argument("--policies", type=int, default=25)
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    found = []
    for case in args.cases:
        note(f"{case} ...")
        found.append(division(*case.split(), args.policies, args.rounds))
    document = {"machine": measure.machine("jax"), "cases": found}
    measure.show(document, [_line(case) for case in found], as_json=args.json)


def _line(case: dict[str, Any]) -> str:
    """Behind a share: the rate if nothing else took time; of noise, which may be negative, none."""
    rate = case["decisions_per_second"]
    parts = []
    for name, share in case["share"].items():
        alone = f" ({digits(rate / share, 2):,.0f}/s)" if share > 0.0 else ""
        parts.append(f"{name} {100 * share:.0f} %{alone}")
    return f"{case['case']}: {rate:,.0f} decisions/s; {', '.join(parts)}"


if __name__ == "__main__":
    main()
