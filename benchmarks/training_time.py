"""How a training in SUMO divides between simulator, environment and learning.

One policy per family is trained for a few episodes by the preset's algorithm, in one process, with
a stopwatch around the simulator's steps, around the rest of the environment (observation, control,
score, start and end of a simulation) and around the algorithm's updates. What remains is the policy
that acts and the library around it. Processor time of one thread.

example: python benchmarks/training_time.py --episodes 5
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import measure
from measure import Cost, Stopwatch, cost_of, digits, note

FAMILIES = {
    "signal": ("signal-inflow", 1000.0),
    "eco": ("eco-green", 35.0),
    "ring": ("ring-acc", 5.0),
    "ramp": ("ramp-acc", 5.0),
}


def timed(watch: Stopwatch, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, charged to a part."""

    def run(*args: Any, **kwargs: Any) -> Any:
        with watch.of(part):
            return function(*args, **kwargs)

    return run


def division(id: str, value: float, episodes: int) -> dict[str, Any]:
    """Shares of one training's processor time."""
    import libsumo

    from mbtl.problems import get_cmdp
    from mbtl.trainers.algorithms import algorithm_class

    cmdp = get_cmdp(id, engine="sumo")
    trainer: Any = cmdp.trainer
    trainer = replace(trainer, episodes=episodes, processes=False, checkpoint="final")
    context = dict.fromkeys(cmdp.space.contexts[0], value)
    env, algorithm = type(trainer.make_env(context)), algorithm_class(trainer.algorithm)
    replace(trainer, episodes=1).train([context], 0)  # what is loaded and compiled only once

    watch = Stopwatch()
    places = [
        (libsumo, "simulationStep", "simulator"),
        (env, "reset", "environment"),
        (env, "step", "environment"),
        (algorithm, "train", "learning"),
    ]
    with ExitStack() as stack:
        for owner, name, part in places:
            timer = timed(watch, part, getattr(owner, name))
            stack.enter_context(patch.object(owner, name, timer))
        whole = cost_of(lambda: trainer.train([context], 0).policy)
    parts = {part: watch.parts.get(part, Cost()) for part in ("simulator", "learning")}
    parts["environment"] = watch.parts["environment"] - parts["simulator"]
    rest = whole - parts["simulator"] - parts["environment"] - parts["learning"]
    parts["acting and the library"] = rest
    return {
        "cmdp": f"{id} at {value:g}",
        "algorithm": trainer.algorithm,
        "seconds_per_episode": (whole / episodes).to_json(),
        "share": {name: digits(cost.cpu / whole.cpu, 2) for name, cost in parts.items()},
    }


def main() -> None:
    """Print a line per family."""
    parser = measure.parser(__doc__)
    parser.add_argument("--episodes", type=int, default=5, help="per training (default 5)")
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    args = parser.parse_args()
    lines = []
    for family in args.families:
        id, value = FAMILIES[family]
        note(f"{id} ...")
        lines.append(division(id, value, args.episodes))
    document = {"machine": measure.machine("libsumo", "stable-baselines3", "torch"), "cases": lines}
    measure.show(document, [_line(case) for case in lines], as_json=args.json)


def _line(case: dict[str, Any]) -> str:
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in case["share"].items())
    seconds = case["seconds_per_episode"]["cpu"]
    return f"{case['cmdp']}, {case['algorithm']}: {seconds:g} s per episode; {shares}"


if __name__ == "__main__":
    main()
