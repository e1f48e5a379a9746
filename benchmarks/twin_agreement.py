"""Do the twins of the ring and of eco-driving agree with SUMO? Means over seeds in both engines.

Unguided traffic (nobody is advised), and one fixed policy: keep a steady speed, 3 m/s on the ring
and 9 m/s in eco-driving, as far as traffic allows. Neither is trained, so that nothing but the
traffic can differ. A difference is given in its standard errors: two thirds should lie within 1,
nearly all within 3. Lines share seeds, so they are not independent. The table is in Markdown.

example: python benchmarks/twin_agreement.py --families eco --seeds 40
"""

from __future__ import annotations

import measure  # first: threads

from collections.abc import Callable, Iterator  # isort: skip
from typing import Any

import numpy as np
from measure import digits, note

Measures = dict[str, Any]
"""Name of a measure -> numbers, one per episode."""

CONTEXTS: dict[str, list[dict[str, float]]] = {
    "ring": [{"hold": 1.0}, {"hold": 40.0}],
    "eco": [{}, {"penetration": 1.0}, {"inflow": 1600.0}, {"green": 5.0}],
}
NAMES = {"score": "speed m/s", "co2": "CO2 g", "stops": "stops", "throughput": "cars/h"}
STEADY = {"ring": 3.0, "eco": 9.0}  # m/s
POLICIES = ("unguided", "steady")


def steady(family: str, obs: Any) -> Any:
    """Acceleration towards the steady speed; (..., f) -> (..., 1) in numpy and jax."""
    from mbtl.cmdps.traffic import eco, ring

    if family == "ring":
        speed = 0.5 * (obs[..., :1] + 1.0) * ring.SCALE[0]
        return (STEADY[family] - speed).clip(-1.0, 1.0)
    return STEADY[family] - obs[..., :1] * eco.SPEED_SCALE


def in_sumo(family: str, context: dict[str, float], policy: str, seeds: int) -> Measures:
    """Episodes with seeds 0, 1, ..."""
    from mbtl.cmdps.traffic.eco import Eco
    from mbtl.cmdps.traffic.ring import RingAcc

    make: Any = {"ring": RingAcc, "eco": Eco}[family]
    env = make(context, visibility="hidden")
    run = {"ring": ring_episode, "eco": eco_episode}[family]
    every = [run(env, seed, policy) for seed in range(seeds)]
    env.close()
    return {name: np.array([one[name] for one in every]) for name in NAMES if name in every[0]}


def ring_episode(env: Any, seed: int, policy: str) -> dict[str, float]:
    obs, _ = env.reset(seed=seed)
    ended = False
    while not ended:
        moved = env.drive() if policy == "unguided" else env.step(steady("ring", obs))
        obs, _, terminated, truncated, info = moved
        ended = terminated or truncated
    return {"score": info["score"]}


def eco_episode(env: Any, seed: int, policy: str) -> dict[str, float]:
    seen, _ = env.reset(seed=seed)
    while env.agents:
        told = {} if policy == "unguided" else {car: steady("eco", seen[car]) for car in env.agents}
        seen = env.step(told)[0]
    return dict(env.summary)


def in_twin(family: str, seeds: int) -> Callable[[dict[str, float], str], Measures]:
    """A function that runs episodes with seeds 0, 1, ...; one compiled program per policy."""
    import mbtl.training.jax  # noqa: F401  isort: skip  # first: flags of jax
    import jax
    import jax.numpy as jnp

    from mbtl.cmdps.traffic.twins import EcoProblem, RingProblem

    problem: Any = RingProblem("acceleration") if family == "ring" else EcoProblem()
    twin = problem([CONTEXTS[family][0]])[0]

    def run(guided: bool, params: Any, decisions: Any) -> Any:
        def one(_: int, state: Any) -> Any:
            if not guided:
                return twin.drive(state, params).state
            action = steady(family, twin.observe(state, params).obs)
            return twin.step(state, action, params).state

        state = twin.start(jnp.arange(seeds, dtype=jnp.uint32), params)
        state = jax.lax.fori_loop(0, decisions, one, state)
        return twin.measures(state) if family == "eco" else {"score": twin.score(state)}

    compiled = jax.jit(run, static_argnums=0)

    def episodes(context: dict[str, float], policy: str) -> Measures:
        (params,) = problem([context])[1]
        found = compiled(policy == "steady", params, twin.decisions(params))
        return {name: np.asarray(found[name], float) for name in NAMES if name in found}

    return episodes


def comparisons(family: str, sumo_seeds: int, twin_seeds: int) -> Iterator[dict[str, Any]]:
    """One record per context, policy and measure."""
    twin = in_twin(family, twin_seeds)
    for context in CONTEXTS[family]:
        for policy in POLICIES:
            note(f"{family} {context} {policy} ...")
            ours = twin(context, policy)
            for name, theirs in in_sumo(family, context, policy, sumo_seeds).items():
                means = [float(x.mean()) for x in (theirs, ours[name])]
                errors = [float(x.std(ddof=1)) / len(x) ** 0.5 for x in (theirs, ours[name])]
                yield {
                    "family": family,
                    "context": context,
                    "policy": policy,
                    "measure": NAMES[name],
                    "sumo": [digits(means[0]), digits(errors[0], 2)],
                    "twin": [digits(means[1]), digits(errors[1], 2)],
                    "difference": digits(means[1] - means[0], 2),
                    "in_standard_errors": digits(
                        (means[1] - means[0]) / max(float(np.hypot(*errors)), 1e-9), 2
                    ),
                }


def line(row: dict[str, Any]) -> str:
    context = ", ".join(f"{name} {value:g}" for name, value in row["context"].items()) or "nominal"
    engines = (f"{mean:g} +- {error:g}" for mean, error in (row["sumo"], row["twin"]))
    cells = [row["family"], context, row["policy"], row["measure"], *engines]
    return "| " + " | ".join([*cells, f"{row['in_standard_errors']:+.1f}"]) + " |"


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--families", nargs="+", choices=list(CONTEXTS), default=list(CONTEXTS))
    parser.add_argument("--seeds", type=int, default=20, help="episodes in SUMO per line")
    parser.add_argument("--twin-seeds", type=int, default=256, help="episodes in the twin")
    args = parser.parse_args()
    rows = [
        row for family in args.families for row in comparisons(family, args.seeds, args.twin_seeds)
    ]
    document = {
        "seeds": {"sumo": args.seeds, "twin": args.twin_seeds},
        "rows": rows,
        "machine": measure.machine("jax", "libsumo"),
    }
    head = ["family", "context", "policy", "measure", "SUMO", "twin", "difference / its error"]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|", *map(line, rows), ""]
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
