"""Do the traffic twins agree with SUMO? Means over seeds in both engines.

Unguided traffic (nobody is advised); one fixed policy: keep a steady speed, 3 m/s on the ring,
9 m/s in eco-driving and 5 m/s on the ramp, as far as traffic allows (ramp-vel: the advised level is
the second, 6.7 m/s). Signals have two others: the phases in turn, 30 s each, and phases at random.
Trained policies are compared by `twin_transfer.py`. Contexts are the nominal one and
others along each axis. A difference is given in its standard errors: two thirds should lie within
1, nearly all within 3. Lines share seeds, so they are not independent. The table is in Markdown.

    taskset -c 0 python evidence/twin_agreement.py --families eco --seeds 40
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

import mbtl.engine.learners  # noqa: F401  isort: skip  # first: flags of jax
import jax
import jax.numpy as jnp

from mbtl.problems import get_cmdp
from mbtl.zoo.cmdps.traffic import eco, ramp, ring
from mbtl.zoo.cmdps.traffic.signal import Signal
from mbtl.zoo.cmdps.traffic.twins import EcoProblem, RampProblem, RingProblem, SignalProblem

Measures = dict[str, Any]
"""Name of a measure -> numbers, one per episode."""
Policy = Callable[[Any], Any]
"""Observations (..., f) -> accelerations (..., 1), or levels (...)."""

HOLDS = [{"hold": 1.0}, {"hold": 5.0}, {"hold": 40.0}]
CONTEXTS: dict[str, list[dict[str, float]]] = {
    "ring": HOLDS,
    "ramp-acc": HOLDS,
    "ramp-vel": HOLDS,
    "eco": [
        {}, {"penetration": 0.02}, {"penetration": 1.0}, {"inflow": 40.0}, {"inflow": 2000.0},
        {"green": 1.0}, {"green": 50.0},
    ],
    "signal": [
        {}, {"inflow": 300.0}, {"inflow": 1500.0}, {"inflow": 2000.0},
        {"length": 50.0}, {"length": 100.0}, {"length": 2500.0},
        {"speed": 1.5}, {"speed": 2.5}, {"speed": 3.5}, {"speed": 5.0}, {"speed": 25.0},
    ],
}  # fmt: skip
TWINS: dict[str, Any] = {
    "ring": RingProblem("acceleration"),
    "ramp-acc": RampProblem("acceleration"),
    "ramp-vel": RampProblem("speed"),
    "eco": EcoProblem(score="paper"),
    "signal": SignalProblem(score="paper"),
}
NAMES = {
    "score": "score", "co2": "CO2 g", "stops": "stops", "throughput": "cars/h",
    "dropped": "dropped share", "mean_queue": "standing cars", "mean_speed": "speed m/s",
}  # fmt: skip
STEADY = {"ring": 3.0, "eco": 9.0, "ramp-acc": 5.0}
"""The speed that is kept, m/s."""
LEVEL = 2
"""The level of ramp-vel that is advised, 6.7 m/s."""
HELD = 3
"""Decisions for which a phase of the light that takes turns has green."""


def steady(family: str, obs: Any) -> Any:
    """Acceleration towards the steady speed, in numpy and jax."""
    if family == "ramp-vel":
        return (0.0 * obs[..., 0]).astype(int) + LEVEL
    if family == "eco":
        return STEADY[family] - obs[..., :1] * eco.SPEED_SCALE
    scale, column = (ring.SCALE[0], 0) if family == "ring" else (ramp.SCALE[1], 1)
    speed = 0.5 * (obs[..., column : column + 1] + 1.0) * scale
    return (STEADY[family] - speed).clip(-1.0, 1.0)


def in_turn(moment: Any) -> Any:
    """A mark: the phase of this decision, whatever is seen."""
    return (moment // HELD) % 4


def at_random(moment: Any) -> Any:
    """A mark: any phase is as likely as another."""
    raise NotImplementedError


def policies(family: str) -> dict[str, Policy | None]:
    """By name; None: unguided."""
    if family == "signal":
        return {"in turn": in_turn, "at random": at_random}
    return {"unguided": None, "steady": partial(steady, family)}


def in_sumo(family: str, context: dict[str, float], policy: Policy | None, seeds: int) -> Measures:
    """Episodes with seeds 0, 1, ..."""
    if family == "eco":
        env: Any = eco.Eco(context, visibility="hidden", score="paper")
    elif family == "signal":
        env = Signal(context, visibility="hidden", score="paper")
    else:
        id = "ring-acc" if family == "ring" else family
        env = get_cmdp(id, engine="sumo", visibility="hidden").make_env(context)
    every = [episode(env, seed, policy) for seed in range(seeds)]
    env.close()
    return {name: np.array([one[name] for one in every]) for name in NAMES if name in every[0]}


def episode(env: Any, seed: int, policy: Policy | None) -> dict[str, float]:
    """What an episode ends with."""
    team = hasattr(env, "agents")
    seen, _ = env.reset(seed=seed)
    space = env.action_space("") if team else env.action_space
    rng, moment = np.random.default_rng(seed), 0

    def told(obs: Any) -> Any:
        if policy is at_random:
            return int(rng.integers(space.n))
        assert policy is not None
        action = policy(moment if policy is in_turn else obs)
        return action if hasattr(space, "low") else int(action)

    while not team or env.agents:
        if team:
            advice = {} if policy is None else {car: told(seen[car]) for car in env.agents}
            seen = env.step(advice)[0]
        else:
            moved = env.drive() if policy is None else env.step(told(seen))
            seen, _, terminated, truncated, info = moved
            if terminated or truncated:
                return dict(info)
        moment += 1
    return dict(env.summary)


@partial(jax.jit, static_argnums=(0, 1, 2))
def played(twin: Any, policy: Policy | None, seeds: int, params: Any, decisions: Any) -> Measures:
    """Episodes with seeds 0, 1, ..."""
    numbers = jnp.arange(seeds, dtype=jnp.uint32)

    def one(moment: Any, state: Any) -> Any:
        if policy is None:
            return twin.drive(state, params).state
        if policy is at_random:
            action = twin.any_actions(numbers, moment)
        elif policy is in_turn:
            action = jnp.full((seeds, 1), in_turn(moment))
        else:
            action = policy(twin.observe(state, params).obs)
        return twin.step(state, action, params).state

    state = jax.lax.fori_loop(0, decisions, one, twin.start(numbers, params))
    others = twin.measures(state) if hasattr(twin, "measures") else {}
    return others | {"score": twin.score(state)}


def in_twin(family: str, context: dict[str, float], policy: Policy | None, seeds: int) -> Measures:
    """The same; one compiled program per policy."""
    twin, (params,) = TWINS[family]([context])
    found = played(twin, policy, seeds, params, twin.decisions(params))
    return {name: np.asarray(found[name], float) for name in NAMES if name in found}


def lines(family: str, sumo_seeds: int, twin_seeds: int) -> Iterator[str]:
    """One per context, policy and measure."""
    ways = policies(family)
    for context in CONTEXTS[family]:
        place = ", ".join(f"{name} {value:g}" for name, value in context.items()) or "nominal"
        for way, policy in ways.items():
            ours = in_twin(family, context, policy, twin_seeds)
            for name, theirs in in_sumo(family, context, policy, sumo_seeds).items():
                both = theirs, ours[name]
                means = [float(x.mean()) for x in both]
                errors = [float(x.std(ddof=1)) / len(x) ** 0.5 for x in both]
                apart = (means[1] - means[0]) / max(float(np.hypot(*errors)), 1e-9)
                each = [f"{m:.4g} +- {e:.2g}" for m, e in zip(means, errors, strict=True)]
                cells = [family, place, way, NAMES[name], *each, f"{apart:+.1f}"]
                yield f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--families", nargs="+", choices=list(CONTEXTS), default=list(CONTEXTS))
    parser.add_argument("--seeds", type=int, default=20, help="episodes in SUMO per line")
    parser.add_argument("--twin-seeds", type=int, default=256, help="episodes in the twin")
    args = parser.parse_args()
    print("| family | context | policy | measure | SUMO | twin | difference / its error |")
    print(f"|{'---|' * 7}")
    for family in args.families:
        print(f"{family} ...", file=sys.stderr)
        for line in lines(family, args.seeds, args.twin_seeds):
            print(line, flush=True)


if __name__ == "__main__":
    main()
