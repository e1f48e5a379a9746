"""Is our traffic that of the paper, before anybody is advised? One check value per family.

The ring without noise from equal gaps, and as it is; the ramp; a signal with fixed times; eco-
driving in which every car drives as its human driver (IDM). Beside each the paper's value, or the
specification's, where there is one. Mean and range over the seeds. The table is in Markdown.

example: python evidence/traffic_checks.py --seeds 5
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import fmean
from typing import Any

import measure
from fixed_advice import PHASES
from measure import digits, note


def unguided(team: Any, seed: int) -> None:
    """An episode in which nobody is told anything."""
    team.reset(seed=seed)
    while team.agents:
        team.step({})


def ring_at_rest(seed: int) -> float:
    """Mean speed of equal cars after the warm-up."""
    from mbtl.zoo.cmdps.traffic.ring import RingAcc

    env = RingAcc(noise=0.0, start="uniform")
    env.reset(seed=seed)
    vehicle = env.simulation.api.vehicle
    speed = fmean(vehicle.getSpeed(car) for car in vehicle.getIDList())
    env.close()
    return speed


def ring(seed: int) -> float:
    """Score without advice."""
    from mbtl.zoo.cmdps.traffic.ring import RingAcc

    env = RingAcc({"hold": 40.0})
    env.reset(seed=seed)
    info: dict[str, Any] = {}
    while not info:
        info = env.drive()[4]
    return float(info["score"])


def ramp(seed: int) -> float:
    """Score without advice."""
    from mbtl.zoo.cmdps.traffic.ramp import RampAcc

    env = RampAcc({"hold": 40.0})
    unguided(env, seed)
    return env.score


def signal(seed: int) -> float:
    """Score of fixed times at the nominal demand."""
    from mbtl.zoo.cmdps.traffic.signal import Signal

    env = Signal(score="paper")
    env.reset(seed=seed)
    decision, info = 0, dict[str, Any]()
    while "score" not in info:
        info = env.step(PHASES[decision % len(PHASES)])[4]
        decision += 1
    return float(info["score"])


def eco(seed: int) -> float:
    """Score in which nobody is commanded."""
    from mbtl.zoo.cmdps.traffic.eco import Eco

    env = Eco(score="paper")
    unguided(env, seed)
    return float(env.summary["score"])


CHECKS: dict[str, tuple[Callable[[int], float], str]] = {
    "ring, equal gaps, no noise, after 100 s, m/s": (ring_at_rest, "4.33, an equilibrium"),
    "ring, unguided, m/s": (ring, "3.6"),
    "ramp, unguided, m/s": (ramp, "3.93"),
    "signal, fixed times 30, 10, 30, 10 s, score": (signal, "-13.5 to -5.7, policies"),
    "eco, all IDM, m/s": (eco, "5.8 to 10.0, policies"),
}


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    args = parser.parse_args()
    lines = ["| | here | there |", "|---|---|---|"]
    document: dict[str, Any] = {"seeds": args.seeds, "values": {}}
    for name, (check, published) in CHECKS.items():
        note(f"{name} ...")
        values = [digits(check(seed), 3) for seed in range(args.seeds)]
        mean = digits(fmean(values), 3)
        document["values"][name] = {"all": values, "mean": mean, "there": published}
        lines.append(f"| {name} | {mean:g} ({min(values):g} to {max(values):g}) | {published} |")
    document["machine"] = measure.machine("libsumo")
    measure.show(document, [*lines, ""], as_json=args.json)


if __name__ == "__main__":
    main()
