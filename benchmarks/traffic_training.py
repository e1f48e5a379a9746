"""Training in the traffic twins against SUMO with Stable-Baselines3, end to end, in one run.

Each engine trains by its own default recipe in one context per family: one policy in SUMO, in one
process (Stable-Baselines3, of TRPO sb3-contrib); 25 policies in one program in the twin, as a
matrix is built. Learning, acting and everything else are in the figure, evaluations are not, nor is
what is compiled or loaded once. Rates are simulated seconds per second of processor time of one
thread; those of an episode, with its warm-up, are read from SUMO's clock.

example: taskset -c 0 python benchmarks/traffic_training.py
"""

from __future__ import annotations

import measure  # first: threads

from dataclasses import replace  # isort: skip
from typing import Any
from unittest.mock import patch

from measure import Cost, cost_of, digits, median, note

FAMILIES = {
    "ring-acc": {"hold": 5.0},
    "ramp-acc": {"hold": 5.0},
    "eco-green": {"green": 35.0},
    "signal-inflow": {"inflow": 1000.0},
}


def in_sumo(id: str, context: dict[str, float], episodes: int) -> tuple[Any, Cost, float]:
    """The trainer, and the cost and the simulated seconds of one episode."""
    import libsumo

    from mbtl.problems import get_cmdp

    trainer: Any = get_cmdp(id, engine="sumo").trainer
    trainer = replace(trainer, processes=False, checkpoint="final")
    replace(trainer, episodes=1).train([context], 0)  # what is loaded only once
    real, clock = libsumo.simulationStep, [0.0]

    def step(*until: float) -> None:
        real(*until)
        clock[0] = max(clock[0], libsumo.simulation.getTime())  # another episode begins at once

    with patch.object(libsumo, "simulationStep", step):
        replace(trainer, episodes=1).train([context], 1)
    trainer = replace(trainer, episodes=episodes)
    cost = cost_of(lambda: trainer.train([context], 2).policy)
    return trainer, cost / episodes, clock[0]


def in_twin(id: str, context: dict[str, float], lanes: int, blocks: int) -> tuple[Any, Cost]:
    """The trainer, and the cost of one episode of one policy."""
    from mbtl.problems import get_cmdp

    trainer: Any = get_cmdp(id, engine="jax").trainer
    trainer = replace(trainer, checkpoint="final", episodes=4 * trainer.update_length)
    seeds = list(range(lanes))

    def train() -> None:
        trainer.train_many([context] * lanes, seeds, keep=("final",))

    train()  # compiles
    each = [cost_of(train) for _ in range(blocks)]
    return trainer, median(each) / (lanes * trainer.episodes)


def case(id: str, context: dict[str, float], args: Any) -> dict[str, Any]:
    """Both engines."""
    note(f"{id} ...")
    sumo, theirs, seconds = in_sumo(id, context, args.episodes)
    twin, ours = in_twin(id, context, args.lanes, args.blocks)
    return {
        "cmdp": id,
        "context": context,
        "simulated_seconds": seconds,
        "algorithms": {"sumo": sumo.algorithm, "twin": twin.algorithm},
        "seconds_per_episode": {"sumo": theirs.to_json(), "twin": ours.to_json()},
        "rate": {"sumo": digits(seconds / theirs.cpu), "twin": digits(seconds / ours.cpu)},
        "ratio": digits(theirs.cpu / ours.cpu, 3),
    }


def main() -> None:
    """Print a line per family."""
    parser = measure.parser(__doc__)
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--episodes", type=int, default=6, help="trained in SUMO (default 6)")
    parser.add_argument("--lanes", type=int, default=25, help="policies in the twin's program")
    parser.add_argument("--blocks", type=int, default=3, help="trainings in the twin; the median")
    args = parser.parse_args()
    cases = [case(id, FAMILIES[id], args) for id in args.families]
    packages = ("libsumo", "stable-baselines3", "sb3-contrib", "torch", "jax")
    document = {"machine": measure.machine(*packages), "cases": cases}
    measure.show(document, [_line(one) for one in cases], as_json=args.json)


def _line(one: dict[str, Any]) -> str:
    rates = one["rate"]
    algorithms = one["algorithms"]
    return (
        f"{one['cmdp']}: {rates['twin']:,.0f} simulated s per s ({algorithms['twin']}) against "
        f"{rates['sumo']:,.0f} in SUMO ({algorithms['sumo']}): {one['ratio']:g} x; an episode has "
        f"{one['simulated_seconds']:g} s"
    )


if __name__ == "__main__":
    main()
