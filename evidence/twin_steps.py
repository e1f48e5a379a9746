"""Does the ramp's twin drive every car as SUMO does? One step ahead from SUMO's own states.

Episodes in SUMO without advice, with random advice and with advised cars that are told to stand;
every tenth step, from the position and speed of all cars, the twin says how fast each will drive in
the next one. Compared are the cars that drive by themselves, by section of the road: the share
whose speed differs by more than 1 mm/s and 1 cm/s, and the mean difference.

example: python evidence/twin_steps.py
"""

from __future__ import annotations

import measure  # first: threads

from collections.abc import Iterator  # isort: skip
from typing import Any

import numpy as np
from measure import digits, note

KINDS: dict[str, tuple[str, float]] = {
    "unguided": ("ramp-acc", 10.0),
    "random accelerations": ("ramp-acc", 2.0),
    "random speeds": ("ramp-vel", 5.0),
    "told to stand": ("ramp-vel", 5.0),
}
SECTIONS = {"main road": (0, False), "main lane, merge": (0, True), "ramp": (1, False)} | {
    "ramp lane, merge": (1, True),
    "behind the zipper": (2, False),
}


def episode(kind: str, seed: int) -> list[tuple[Any, ...]]:
    """Per step the cars: whether from the main road, x, speed driven, speed, v0, told, name."""
    from mbtl.problems import get_cmdp
    from mbtl.zoo.cmdps.traffic import ramp

    name, hold = KINDS[kind]
    env = get_cmdp(name, engine="sumo", visibility="hidden").make_env({"hold": hold})
    found: list[tuple[Any, ...]] = []
    env.reset(seed=seed)
    drive, rng = env._drivers.step, np.random.default_rng(seed)

    def watched(api: Any, cars: Any, steady: Any) -> Any:
        driven, vehicle = drive(api, cars, steady), api.vehicle
        x = [vehicle.getLanePosition(car) - ramp._AHEAD[vehicle.getRoadID(car)] for car in cars]
        now = [vehicle.getSpeed(car) for car in cars]
        wish = [vehicle.getAllowedSpeed(car) for car in cars]
        told = [kind != "unguided" and car in env._advised for car in cars]
        main = [car.startswith("main") for car in cars]
        found.append((*map(np.array, (main, x, driven, now, wish, told)), list(cars)))
        return driven

    env._drivers.step = watched
    while env.agents:
        draw = {
            "unguided": {},
            "random accelerations": {car: rng.uniform(-1, 1, 1) for car in env.agents},
            "random speeds": {car: int(rng.integers(10)) for car in env.agents},
            "told to stand": dict.fromkeys(env.agents, 0),
        }
        env.step(draw[kind])
    return found


def compared(kind: str, steps: list[tuple[Any, ...]], every: int) -> Iterator[dict[str, Any]]:
    """One record per section."""
    import mbtl.engine.learners  # noqa: F401  isort: skip  # first: flags of jax
    import jax
    import jax.numpy as jnp

    from mbtl.zoo.cmdps.traffic.twins import RampProblem
    from mbtl.zoo.worlds.traffic.ramp import RAMP_CAR, Queue, empty

    twin = RampProblem("speed")([])[0]
    chosen = range(0, len(steps) - 1, every)
    rows = (90, 40, 8)
    queues = [[np.array(x) for x in empty(r, len(chosen))] for r in rows]
    next_speed = [np.full((r, len(chosen)), np.nan) for r in rows]
    for j, t in enumerate(chosen):
        main, x, _, now, wish, told, names = steps[t]
        later = dict(zip(steps[t + 1][-1], steps[t + 1][2], strict=True))
        for q, mask in enumerate((main & (x <= 0), ~main & (x <= 0), x > 0)):
            own = np.flatnonzero(mask)[np.argsort(-x[mask])]
            obeyed = [later.get(names[i], np.inf) if told[i] else np.inf for i in own]
            columns = (x[own], now[own], wish[own], obeyed, np.where(main[own], 1, RAMP_CAR))
            for field, values in zip(queues[q], columns, strict=True):
                field[: len(own), j] = values
            free = [np.nan if told[i] else later.get(names[i], np.nan) for i in own]
            next_speed[q][: len(own), j] = free
    roads = [Queue(*map(jnp.asarray, queue)) for queue in queues]
    speeds = jax.jit(lambda *roads: twin.drivers.speeds(*roads, True))(*roads)
    for section, (q, merging) in SECTIONS.items():
        within = (queues[q][0] >= -twin.roads.merge) == (merging or q == 2)
        apart = np.abs(np.asarray(speeds[q]) - next_speed[q])[within]
        apart = apart[~np.isnan(apart)]
        yield {
            "traffic": kind,
            "section": section,
            "cars": len(apart),
            "over_1_mm_s": digits(float((apart > 1e-3).mean()), 2),
            "over_1_cm_s": digits(float((apart > 1e-2).mean()), 2),
            "mean": digits(float(apart.mean()), 2),
        }


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=10, help="steps")
    args = parser.parse_args()
    rows = []
    for kind in KINDS:
        note(f"{kind} ...")
        rows += list(compared(kind, episode(kind, args.seed), args.every))
    lines = ["| traffic | section | cars | > 1 mm/s | > 1 cm/s | mean, m/s |", "|---" * 6 + "|"]
    lines += [
        f"| {row['traffic']} | {row['section']} | {row['cars']} | {row['over_1_mm_s']:.2%} | "
        f"{row['over_1_cm_s']:.2%} | {row['mean']:.5f} |"
        for row in rows
    ]
    document = {"seed": args.seed, "rows": rows, "machine": measure.machine("jax", "libsumo")}
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
