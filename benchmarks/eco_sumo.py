"""Steps per second of eco-driving in SUMO, and what the observation and control calls cost.

Each context is driven four times with the same cars: SUMO alone, stepped and asked nothing; with
the measures that score an episode; with observations of all agents too; with a command to each of
them as well. The command is the highest acceleration, which SUMO cuts to what the car would do by
itself, so that traffic is the same in all four. A reset, which drives until there is an agent, is
timed apart; seeds whose episode has none are passed over.

example: python benchmarks/eco_sumo.py
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count, islice
from typing import Any

import measure
from measure import Cost, cost_of, digits, median, note

CONTEXTS: dict[str, dict[str, float]] = {
    "nominal": {},
    "penetration 1": {"penetration": 1.0},
    "inflow 2000/h": {"inflow": 2000.0},
    "green 1 s": {"green": 1.0},
}


def alone(env: Any, steps: int) -> None:
    with env.simulation.guard() as api:
        for _ in range(steps):
            api.simulationStep()


def measured(env: Any, steps: int) -> None:
    with env.simulation.guard() as api:
        for _ in range(steps):
            api.simulationStep()
            env._region.update(api)


def observed(env: Any, steps: int) -> None:
    while env.agents:
        env.step({})


def controlled(env: Any, steps: int) -> None:
    hardest = env.action_space("").high
    while env.agents:
        env.step(dict.fromkeys(env.agents, hardest))


WAYS: dict[str, Callable[[Any, int], None]] = {
    "SUMO alone": alone,
    "+ measures": measured,
    "+ observations": observed,
    "+ control": controlled,
}


def compare(context: dict[str, float], rounds: int) -> dict[str, Any]:
    """Steps per second of processor time in each way, and milliseconds of a reset."""
    from mbtl.zoo.cmdps.traffic.eco import Eco

    env = Eco(context)
    costs: dict[str, list[Cost]] = {name: [] for name in WAYS}
    resets, agents = [], 0
    for seed in islice(filter(lambda seed: env.reset(seed=seed)[0], count()), rounds):
        for name, drive in WAYS.items():
            resets.append(cost_of(lambda seed=seed: env.reset(seed=seed)))
            steps = env._left  # what the reset has left: it waits for the first agent
            costs[name].append(cost_of(lambda d=drive, n=steps: d(env, n)) / steps)
        agents += len(env.possible_agents)
        env.close()
    return {
        "steps_per_second": {n: digits(1.0 / median(each).cpu, 3) for n, each in costs.items()},
        "reset_ms": median(resets).to_json(1e-3),
        "agents_per_episode": agents / rounds,
    }


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="episodes per context and way")
    args = parser.parse_args()
    results = {}
    for name, context in CONTEXTS.items():
        note(f"{name} ...")
        results[name] = compare(context, args.rounds)
    document = {
        "rounds": args.rounds,
        "contexts": CONTEXTS,
        "results": results,
        "machine": measure.machine("libsumo"),
    }
    lines = ["steps (0.5 s of traffic) per second of processor time"]
    lines.append(" " * 16 + "".join(f"{way:>16}" for way in WAYS) + f"{'reset ms':>10}")
    for name, result in results.items():
        rates = "".join(f"{rate:16.0f}" for rate in result["steps_per_second"].values())
        lines.append(f"  {name:14}{rates}{result['reset_ms']['cpu']:10.1f}")
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
