"""Do the twins of the ring and of eco-driving agree with SUMO? Means over seeds in both engines.

Unguided traffic (nobody is advised); one fixed policy: keep a steady speed, 3 m/s on the ring and
9 m/s in eco-driving, as far as traffic allows; and one trained in the twin, at a hold of 5 s
(preset `quick`) or in the nominal context (`standard`), by its mean actions. Contexts are the
nominal one and the ends of each axis. Measures of the ring beside its score, mean speed, are those
of the wave, over the cars at each decision: the deviation of their speeds and the share that
stands (its throughput is its speed times 22 cars / 250 m). A difference is given in its standard
errors: two thirds should lie within 1, nearly all within 3. Lines share seeds, so they are not
independent. The table is in Markdown.

example: python benchmarks/twin_agreement.py --families eco --seeds 40
"""

from __future__ import annotations

import measure  # first: threads

from collections.abc import Callable, Iterator  # isort: skip
from functools import partial
from typing import Any

import numpy as np
from measure import digits, note

Measures = dict[str, Any]
"""Name of a measure -> numbers, one per episode."""

CONTEXTS: dict[str, list[dict[str, float]]] = {
    "ring": [{"hold": 1.0}, {"hold": 5.0}, {"hold": 40.0}],
    "eco": [
        {},
        *({"penetration": 0.02}, {"penetration": 1.0}),
        *({"inflow": 40.0}, {"inflow": 2000.0}),
        *({"green": 1.0}, {"green": 50.0}),
    ],
}
NAMES = {
    "score": "speed m/s",
    "spread": "deviation m/s",
    "standing": "standing %",
    "co2": "CO2 g",
    "stops": "stops",
    "throughput": "cars/h",
}
STEADY = {"ring": 3.0, "eco": 9.0}  # m/s
STANDS = 0.1  # m/s
LESSON = {"ring": ("ring-acc", "quick", {"hold": 5.0}), "eco": ("eco-green", "standard", {})}
"""CMDP, preset and context of the policy that is trained."""

Policy = Callable[[Any], Any]
"""Observations (..., f) -> accelerations (..., 1)."""


def steady(family: str, obs: Any) -> Any:
    """Acceleration towards the steady speed, in numpy and jax."""
    from mbtl.cmdps.traffic import eco, ring

    if family == "ring":
        speed = 0.5 * (obs[..., :1] + 1.0) * ring.SCALE[0]
        return (STEADY[family] - speed).clip(-1.0, 1.0)
    return STEADY[family] - obs[..., :1] * eco.SPEED_SCALE


def policies(family: str) -> dict[str, tuple[Policy | None, Policy | None]]:
    """By name, for SUMO (numpy, one observation) and for the twin (jax); None: unguided."""
    import mbtl.training.jax  # noqa: F401  isort: skip  # first: flags of jax
    import jax

    from mbtl.cmdps import get_cmdp
    from mbtl.training.jax import networks
    from mbtl.training.jax.traffic.episodes import import_actor

    cmdp_id, preset, context = LESSON[family]
    cmdp = get_cmdp(cmdp_id, engine="jax", visibility="hidden")
    note(f"{family}: training at {context or 'the nominal context'} ...")
    trainer = cmdp.trainer_for(preset)
    learnt = trainer.train({**cmdp.nominal, **context}, 0)
    network = jax.tree.map(lambda x: x[0], import_actor([learnt]).network)
    box = trainer.problem([{}])[0].action

    def in_numpy(obs: Any) -> Any:
        return learnt.predict(obs[None])[0][0]

    def in_jax(obs: Any) -> Any:
        return networks.mode(networks.apply(network, obs, learnt.activation), box)

    fixed = partial(steady, family)
    return {"unguided": (None, None), "steady": (fixed, fixed), "trained": (in_numpy, in_jax)}


def in_sumo(family: str, context: dict[str, float], policy: Policy | None, seeds: int) -> Measures:
    """Episodes with seeds 0, 1, ..."""
    from mbtl.cmdps.traffic.eco import Eco
    from mbtl.cmdps.traffic.ring import RingAcc

    make: Any = {"ring": RingAcc, "eco": Eco}[family]
    env = make(context, visibility="hidden")
    run = {"ring": ring_episode, "eco": eco_episode}[family]
    every = [run(env, seed, policy) for seed in range(seeds)]
    env.close()
    return {name: np.array([one[name] for one in every]) for name in NAMES if name in every[0]}


def ring_episode(env: Any, seed: int, policy: Policy | None) -> dict[str, float]:
    obs, _ = env.reset(seed=seed)
    ended, waves = False, []
    while not ended:
        vehicle = env.simulation.api.vehicle
        speeds = np.array([vehicle.getSpeed(car) for car in vehicle.getIDList()])
        waves.append((speeds.std(), 100.0 * (speeds < STANDS).mean()))
        moved = env.drive() if policy is None else env.step(policy(obs))
        obs, _, terminated, truncated, info = moved
        ended = terminated or truncated
    spread, standing = np.mean(waves, axis=0)
    return {"score": info["score"], "spread": spread, "standing": standing}


def eco_episode(env: Any, seed: int, policy: Policy | None) -> dict[str, float]:
    seen, _ = env.reset(seed=seed)
    while env.agents:
        told = {} if policy is None else {car: policy(seen[car]) for car in env.agents}
        seen = env.step(told)[0]
    return dict(env.summary)


def in_twin(family: str, seeds: int) -> Callable[[dict[str, float], Policy | None], Measures]:
    """A function that runs episodes with seeds 0, 1, ...; one compiled program per policy."""
    import mbtl.training.jax  # noqa: F401  isort: skip  # first: flags of jax
    import jax
    import jax.numpy as jnp

    from mbtl.cmdps.traffic.twins import EcoProblem, RingProblem

    problem: Any = RingProblem("acceleration") if family == "ring" else EcoProblem()
    twin = problem([CONTEXTS[family][0]])[0]

    def wave(state: Any) -> Any:
        if family == "eco":
            return jnp.zeros((2, seeds))
        return jnp.stack([state.speed.std(axis=0), 100.0 * (state.speed < STANDS).mean(axis=0)])

    def run(policy: Policy | None, params: Any, decisions: Any) -> Any:
        def one(_: int, carry: Any) -> Any:
            state, waves = carry
            waves += wave(state)
            if policy is None:
                return twin.drive(state, params).state, waves
            action = policy(twin.observe(state, params).obs)
            return twin.step(state, action, params).state, waves

        state = twin.start(jnp.arange(seeds, dtype=jnp.uint32), params)
        state, waves = jax.lax.fori_loop(0, decisions, one, (state, jnp.zeros((2, seeds))))
        if family == "eco":
            return twin.measures(state)
        spread, standing = waves / decisions
        return {"score": twin.score(state), "spread": spread, "standing": standing}

    compiled = jax.jit(run, static_argnums=0)

    def episodes(context: dict[str, float], policy: Policy | None) -> Measures:
        (params,) = problem([context])[1]
        found = compiled(policy, params, twin.decisions(params))
        return {name: np.asarray(found[name], float) for name in NAMES if name in found}

    return episodes


def comparisons(family: str, sumo_seeds: int, twin_seeds: int) -> Iterator[dict[str, Any]]:
    """One record per context, policy and measure."""
    twin, ways = in_twin(family, twin_seeds), policies(family)
    for context in CONTEXTS[family]:
        for policy, (here, there) in ways.items():
            note(f"{family} {context} {policy} ...")
            ours = twin(context, there)
            for name, theirs in in_sumo(family, context, here, sumo_seeds).items():
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
