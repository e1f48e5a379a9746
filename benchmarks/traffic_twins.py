"""Simulation steps per second of the traffic twins against SUMO, in one run, on one thread.

SUMO is driven as training drives it: observations and control of all agents (ring and ramp hold
each instruction for 1 s, ten steps). The twin runs many simulations at once, without advice and
with observations and control by the same rule as in SUMO. No network is evaluated in either
engine. Rates are per second of processor time; resets and compiling are left out.

example: python benchmarks/traffic_twins.py --families eco
"""

from __future__ import annotations

import measure  # first: threads

from typing import Any  # isort: skip

from measure import cost_of, digits, median, note

CONTEXTS: dict[str, dict[str, dict[str, float]]] = {
    "ring": {"hold 1 s": {"hold": 1.0}},
    "ramp-acc": {"hold 1 s": {"hold": 1.0}},
    "eco": {
        "nominal": {},
        "penetration 1": {"penetration": 1.0},
        "inflow 2000/h": {"inflow": 2000.0},
        "green 1 s": {"green": 1.0},
    },
}
STEADY = {"ring": 3.0, "eco": 9.0, "ramp-acc": 5.0}
"""The speed that `steady` keeps, m/s: advice that nobody has learned, the same in both."""


def steady(family: str, obs: Any) -> Any:
    """Acceleration towards the steady speed, in numpy and jax."""
    from mbtl.zoo.cmdps.traffic import eco, ramp, ring

    if family == "eco":
        return STEADY[family] - obs[..., :1] * eco.SPEED_SCALE
    own, scale = obs[..., :1], ring.SCALE[0]
    if family == "ramp-acc":
        own, scale = obs[..., 1:2], ramp.SCALE[1]
    return (STEADY[family] - 0.5 * (own + 1.0) * scale).clip(-1.0, 1.0)


def sumo_rate(family: str, context: dict[str, float], rounds: int) -> float:
    """Steps per second after the reset, with observations and control."""
    from mbtl.zoo.cmdps.traffic.eco import Eco
    from mbtl.zoo.cmdps.traffic.ramp import RampAcc
    from mbtl.zoo.cmdps.traffic.ring import RingAcc

    make: Any = {"ring": RingAcc, "ramp-acc": RampAcc, "eco": Eco}[family]
    env = make(context, visibility="hidden")
    costs = []
    seed = 0
    while len(costs) < rounds:
        obs, _ = env.reset(seed=seed)
        seed += 1
        if family == "eco" and not env.agents:
            continue  # nobody is controlled in this episode
        steps = env._left if family == "eco" else 10 * env._left

        def drive(obs: Any = obs) -> None:
            if family != "ring":
                while env.agents:
                    obs = env.step({car: steady(family, obs[car]) for car in env.agents})[0]
                return
            ended = False
            while not ended:
                obs, _, terminated, truncated, _ = env.step(steady("ring", obs))
                ended = terminated or truncated

        costs.append(cost_of(drive) / steps)
    env.close()
    return 1.0 / median(costs).cpu


def twin_rates(family: str, simulations: int, rounds: int) -> dict[str, Any]:
    """Steps per second in each context and way; seconds of compiling."""
    import mbtl.engine.learners  # noqa: F401  isort: skip  # first: flags of jax
    import jax
    import jax.numpy as jnp

    from mbtl.zoo.cmdps.traffic.twins import EcoProblem, RampProblem, RingProblem

    problems: dict[str, Any] = {
        "ring": RingProblem("acceleration"),
        "ramp-acc": RampProblem("acceleration"),
        "eco": EcoProblem(),
    }
    problem = problems[family]
    names = list(CONTEXTS[family])
    twin, each = problem(list(CONTEXTS[family].values()))
    decisions = twin.decisions(each[0])
    per_decision = 1 if family == "eco" else 10

    def play(guided: bool, state: Any, params: Any) -> Any:
        def one(_: int, carry: Any) -> Any:
            state, total = carry
            if guided:
                moved = twin.step(state, steady(family, twin.observe(state, params).obs), params)
            else:
                moved = twin.drive(state, params)
            return moved.state, total + moved.reward.sum()  # learning reads all rewards

        state, total = jax.lax.fori_loop(0, decisions, one, (state, jnp.float32(0.0)))
        return twin.score(state), total

    start, run = jax.jit(twin.start), jax.jit(play, static_argnums=0)
    seeds = jnp.arange(simulations, dtype=jnp.uint32)
    found: dict[str, Any] = {"compile_s": {}}
    for guided, way in ((False, "unguided"), (True, "controlled")):
        state = start(seeds, each[0])
        note(f"{family} twin, {way} ...")
        compiling = cost_of(lambda g=guided, s=state: jax.block_until_ready(run(g, s, each[0])))
        found["compile_s"][way] = digits(compiling.cpu, 2)
        for name, params in zip(names, each, strict=True):
            state = jax.block_until_ready(start(seeds, params))
            costs = [
                cost_of(lambda g=guided, s=state, p=params: jax.block_until_ready(run(g, s, p)))
                for _ in range(rounds)
            ]
            rate = simulations * decisions * per_decision / median(costs).cpu
            found.setdefault(name, {})[way] = digits(rate, 3)
    return found


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--families", nargs="+", choices=list(CONTEXTS), default=list(CONTEXTS))
    parser.add_argument("--simulations", type=int, default=64, help="at once in the twin")
    parser.add_argument("--rounds", type=int, default=3, help="the median of so many is taken")
    args = parser.parse_args()
    results: dict[str, Any] = {}
    lines = ["simulation steps per second of processor time"]
    lines.append(f"  {'':20}{'SUMO':>10}{'twin, unguided':>22}{'twin, controlled':>22}")
    for family in args.families:
        twin = twin_rates(family, args.simulations, args.rounds)
        results[family] = {"compile_s": twin.pop("compile_s")}
        for name, rates in twin.items():
            note(f"{family} in SUMO, {name} ...")
            sumo = digits(sumo_rate(family, CONTEXTS[family][name], args.rounds), 3)
            ratios = {way: digits(rate / sumo, 2) for way, rate in rates.items()}
            results[family][name] = {"sumo": sumo, "twin": rates, "ratio": ratios}
            cells = "".join(f"{rates[way]:>14,.0f} ({ratios[way]:4.0f} x)" for way in rates)
            lines.append(f"  {family + ', ' + name:20}{sumo:10,.0f}{cells}")
    document = {
        "simulations": args.simulations,
        "rounds": args.rounds,
        "results": results,
        "machine": measure.machine("jax", "libsumo"),
    }
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
