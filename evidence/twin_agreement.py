"""Do the traffic twins agree with SUMO? Means over seeds in both engines.

Unguided traffic (nobody is advised); one fixed policy: keep a steady speed, 3 m/s on the ring,
9 m/s in eco-driving and 5 m/s on the ramp, as far as traffic allows (ramp-vel: the advised level is
the second, 6.7 m/s); on the ramp random advice, too; and one trained in the twin, at a hold of 5 s
(preset `quick`) or in the nominal context (`standard`), by its mean actions. Contexts are the
nominal one and the ends of each axis. Measures of the ring beside its score, mean speed, are those
of the wave, over the cars at each decision: the deviation of their speeds and the share that
stands (its throughput is its speed times 22 cars / 250 m). Those of the ramp are the cars that
leave per hour, the share of those that came that found no room, and at each decision the cars on
the main road and on the ramp before the zipper and the mean speed within the merge section. A
difference is given in its standard errors: two thirds should lie within 1, nearly all within 3.
Lines share seeds, so they are not independent. The table is in Markdown.

example: python evidence/twin_agreement.py --families eco --seeds 40
"""

from __future__ import annotations

import measure  # first: threads

from collections.abc import Callable, Iterator  # isort: skip
from functools import partial
from typing import Any

import numpy as np
import pages
from fixed_advice import steady
from measure import digits, note

Measures = dict[str, Any]
"""Name of a measure -> numbers, one per episode."""

CONTEXTS: dict[str, list[dict[str, float]]] = {
    "ring": [{"hold": 1.0}, {"hold": 5.0}, {"hold": 40.0}],
    "ramp-acc": [{"hold": 1.0}, {"hold": 5.0}, {"hold": 40.0}],
    "ramp-vel": [{"hold": 1.0}, {"hold": 5.0}, {"hold": 40.0}],
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
    "dropped": "dropped share",
    "main": "cars, main road",
    "ramp": "cars, ramp",
    "merge": "merge m/s",
}
WAVES = {"ring": ("spread", "standing"), "eco": ()} | dict.fromkeys(
    ("ramp-acc", "ramp-vel"), ("main", "ramp", "merge")
)
"""Measures that are means over the decisions."""
STANDS = 0.1  # m/s
LESSON = {
    "ring": ("ring-acc", "quick", {"hold": 5.0}),
    "ramp-acc": ("ramp-acc", "quick", {"hold": 5.0}),
    "ramp-vel": ("ramp-vel", "quick", {"hold": 5.0}),
    "eco": ("eco-green", "standard", {}),
}
"""CMDP, preset and context of the policy that is trained."""

Policy = Callable[[Any], Any]
"""Observations (..., f) -> accelerations (..., 1), or levels (...)."""


def _random(obs: Any) -> Any:
    """A mark: any action is as likely as another."""
    raise NotImplementedError


def policies(family: str) -> dict[str, tuple[Policy | None, Policy | None]]:
    """By name, for SUMO (numpy, one observation) and for the twin (jax); None: unguided."""
    import mbtl.engine.learners  # noqa: F401  isort: skip  # first: flags of jax
    import jax

    from mbtl.engine.learners import networks
    from mbtl.engine.learners.episodic.episodes import import_actor
    from mbtl.problems import get_cmdp

    cmdp_id, preset, context = LESSON[family]
    cmdp = get_cmdp(cmdp_id, engine="jax", visibility="hidden")
    note(f"{family}: training at {context or 'the nominal context'} ...")
    trainer = cmdp.trainer_for(preset)
    learnt = trainer.train([{**cmdp.nominal, **context}], 0).policy
    network = jax.tree.map(lambda x: x[0], import_actor([learnt]).network)
    box = trainer.problem([{}])[0].action

    def in_numpy(obs: Any) -> Any:
        return learnt.predict(obs[None])[0][0]

    def in_jax(obs: Any) -> Any:
        return networks.mode(networks.apply(network, obs, learnt.activation), box)

    fixed = partial(steady, family)
    found: dict[str, tuple[Policy | None, Policy | None]] = {
        "unguided": (None, None),
        "steady": (fixed, fixed),
        "trained": (in_numpy, in_jax),
    }
    if family.startswith("ramp"):
        found["random"] = (_random, _random)
    return found


def in_sumo(family: str, context: dict[str, float], policy: Policy | None, seeds: int) -> Measures:
    """Episodes with seeds 0, 1, ..."""
    from mbtl.problems import get_cmdp
    from mbtl.zoo.cmdps.traffic.eco import Eco

    if family == "eco":
        env: Any = Eco(context, visibility="hidden", score="paper")
    else:
        name = "ring-acc" if family == "ring" else family
        env = get_cmdp(name, engine="sumo", visibility="hidden").make_env(context)
    run = {"ring": ring_episode, "eco": eco_episode}.get(family, ramp_episode)
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


def ramp_episode(env: Any, seed: int, policy: Policy | None) -> dict[str, float]:
    from mbtl.zoo.cmdps.traffic.ramp import MERGE, _distance

    seen, _ = env.reset(seed=seed)
    space, rng = env.action_space(""), np.random.default_rng(seed)
    acceleration, waves = space.shape == (1,), []
    while env.agents:
        vehicle = env.simulation.api.vehicle
        before = {c: d for c in vehicle.getIDList() if (d := _distance(vehicle, c)) > 0.0}
        near = [vehicle.getSpeed(car) for car, d in before.items() if d <= MERGE]
        main = sum(car.startswith("main") for car in before)
        waves.append((main, len(before) - main, np.mean(near) if near else np.nan))
        told: dict[str, Any] = {}
        for car in () if policy is None else env.agents:
            if policy is _random:
                told[car] = rng.uniform(-1, 1, 1) if acceleration else int(rng.integers(space.n))
            else:
                told[car] = policy(seen[car]) if acceleration else int(policy(seen[car]))
        seen = env.step(told)[0]
    means = np.nanmean(waves, axis=0)
    return {**env.summary, **dict(zip(("main", "ramp", "merge"), means, strict=True))}


def in_twin(family: str, seeds: int) -> Callable[[dict[str, float], Policy | None], Measures]:
    """A function that runs episodes with seeds 0, 1, ...; one compiled program per policy."""
    import mbtl.engine.learners  # noqa: F401  isort: skip  # first: flags of jax
    import jax
    import jax.numpy as jnp

    from mbtl.zoo.cmdps.traffic.twins import EcoProblem, RampProblem, RingProblem

    problems: dict[str, Any] = {
        "ring": RingProblem("acceleration"),
        "ramp-acc": RampProblem("acceleration"),
        "ramp-vel": RampProblem("speed"),
        "eco": EcoProblem(score="paper"),
    }
    problem = problems[family]
    twin = problem([CONTEXTS[family][0]])[0]
    names = WAVES[family]

    def wave(state: Any) -> Any:
        if family == "ring":
            standing = 100.0 * (state.speed < STANDS).mean(axis=0)
            return jnp.stack([state.speed.std(axis=0), standing])
        if family == "eco":
            return jnp.zeros((0, seeds))
        queues = (state.main, state.side)
        near = [q.x >= -twin.roads.merge for q in queues]
        speeds = sum((q.speed * n).sum(axis=0) for q, n in zip(queues, near, strict=True))
        cars = [(q.x > -1e3).sum(axis=0) for q in queues]
        count = sum(n.sum(axis=0) for n in near)
        return jnp.stack([*cars, speeds / jnp.maximum(count, 1)])

    def run(policy: Policy | None, params: Any, decisions: Any) -> Any:
        numbers = jnp.arange(seeds, dtype=jnp.uint32)

        def one(moment: Any, carry: Any) -> Any:
            state, waves = carry
            waves += wave(state)
            if policy is None:
                return twin.drive(state, params).state, waves
            if policy is _random:
                action = twin.any_actions(numbers, moment)
            else:
                action = policy(twin.observe(state, params).obs)
            return twin.step(state, action, params).state, waves

        state = twin.start(numbers, params)
        first = (state, jnp.zeros((len(names), seeds)))
        state, waves = jax.lax.fori_loop(0, decisions, one, first)
        found = {"score": twin.score(state)} if family == "ring" else twin.measures(state)
        return {**found, **dict(zip(names, waves / decisions, strict=True))}

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
    parser.add_argument("--write", action="store_true", help="docs/appendix/twin-agreement.md")
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
    if args.write:
        title = "The twins against SUMO: all means"
        pages.write_appendix("twin-agreement", title, "twin-agreement.md", lines)


if __name__ == "__main__":
    main()
