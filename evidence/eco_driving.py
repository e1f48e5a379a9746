"""What policies of eco-driving win on unguided traffic, each in its own context.

Trains a preset on every tenth context of each axis, all in one program, and plays the policies
before the first update (`standard` begins with a hand-written rule) and after the last. Beside the
paper's score stand CO2 and stops of a trip and completed cars per hour. Differences to unguided
traffic are paired by episode and come with 95 % intervals over episodes.

    python evidence/eco_driving.py --every 12 --seeds 16
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import mbtl.engine.learners  # noqa: F401  isort: skip  # first: flags of jax
import jax.numpy as jnp

from mbtl.engine.learners.episodic.episodes import Actor, import_actor
from mbtl.engine.learners.evaluation import own_measures
from mbtl.problems import get_cmdp
from mbtl.zoo.cmdps.engines import EnvFactory, TwinProblem

NOMINAL = {"penetration": 0.2, "inflow": 400.0, "green": 35.0}
AXES = ("eco-green", "eco-inflow", "eco-penetration")
FRESH = 5000
"""Seeds of evaluations begin here."""


def measures(
    world: Any, params: Any, policies: Sequence[Any] | None, episodes: int
) -> dict[str, Any]:
    """Measures (contexts, episodes) of policies in their own context; None: unguided."""
    n = len(params.visible)
    seeds = np.tile(np.arange(FRESH, FRESH + episodes, dtype=np.uint32), (n, 1))
    if policies is None:
        found = own_measures(world, "tanh", "none", Actor((), jnp.zeros((n, 1))), seeds, params)
    else:
        found = own_measures(world, "tanh", "mean", import_actor([*policies]), seeds, params)
    return {name: np.asarray(x, float) for name, x in found.items()}


def line(name: str, found: Any, base: Any) -> str:
    """Means over contexts; intervals are over episodes, which contexts share."""
    score, co2, stops, cars = (found[key].mean() for key in ("score", "co2", "stops", "throughput"))
    apart = (found["score"] - base["score"]).mean(axis=0)
    half = 1.96 * apart.std(ddof=1) / len(apart) ** 0.5
    return (
        f"| {name} | {score:.2f} | {apart.mean():+.2f} +- {half:.2f} | {co2:.0f} | {stops:.2f} "
        f"| {cars:.0f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--axes", nargs="+", choices=AXES, default=AXES)
    parser.add_argument("--every", type=int, default=10, help="contexts of an axis")
    parser.add_argument("--seeds", type=int, default=32, help="episodes per policy")
    parser.add_argument("--trainings", type=int, default=1, help="per context")
    parser.add_argument("--rows", type=int, help="at most so many decisions in an update")
    parser.add_argument("--length", type=int, help="episodes of a training")
    args = parser.parse_args()
    cmdps = {name: get_cmdp(name, engine="jax", score="paper") for name in args.axes}
    grids = {name: c.space.contexts[args.every // 2 :: args.every] for name, c in cmdps.items()}
    contexts = [{**NOMINAL, **one} for grid in grids.values() for one in [*grid] * args.trainings]
    changed: dict[str, Any] = {"hyperparameters": {"rows": args.rows} if args.rows else {}}
    changed |= {"episodes": args.length} if args.length else {}
    trainer: Any = cmdps[args.axes[0]].trainer_for(
        args.preset, **{name: value for name, value in changed.items() if value}
    )
    every_axis = EnvFactory("mbtl.zoo.cmdps.traffic.eco:Eco")
    trainer = replace(trainer, problem=TwinProblem(trainer.problem.problem, every_axis))
    start = time.process_time()
    policies = trainer.train_many(
        contexts,
        range(len(contexts)),
        on_progress=lambda done: print(f"{done.step:,} of {done.total:,}", file=sys.stderr),
        keep=(trainer.checkpoint,),
    )
    minutes = (time.process_time() - start) / 60.0
    ways = {
        "unguided": None,
        "untrained": [trainer.untrained(contexts[0])] * len(contexts),
        "trained": policies[trainer.checkpoint],
    }
    world, params = trainer.problem(contexts)
    plays = {way: measures(world, params, each, args.seeds) for way, each in ways.items()}
    print("| | score m/s | less unguided | CO2 g | stops | cars/h |\n|---|---|---|---|---|---|")
    first = 0
    for name, grid in grids.items():
        some = slice(first, first + len(grid) * args.trainings)
        first = some.stop
        mine = {way: {key: x[some] for key, x in found.items()} for way, found in plays.items()}
        for way, found in mine.items():
            print(line(f"{name}: {way}", found, mine["unguided"]))
    print(f"{minutes:.1f} processor minutes for {len(contexts)} trainings")


if __name__ == "__main__":
    main()
