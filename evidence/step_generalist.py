"""Tables of `steps.py`: one policy that sees the context and is trained on all, on the same axis.

Such policies are shipped at two lengths at most, once and ten times a whole training, as the best
of fifty checks. Two prices: training and an evaluation with ten episodes everywhere, which flatters
them; and the checks besides, two episodes on every context each, which is what was done.

Notation (shapes): S seeds, K lengths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from step_tables import Play, Plays, Sets

from mbtl.benchmark.multitask import load_multitask
from mbtl.benchmark.step_measure import StepScale
from mbtl.benchmark.steps import ONE_PER_STEP, StepWorld

METHODS = ("ppo", "trpo", "ppo-x10", "trpo-x10")
CHECKS, CHECK_EPISODES, CHECKS_OF_EPISODES = 50, 2, 20


@dataclass(frozen=True)
class Point:
    """One policy for all contexts.

    Attributes:
        times: length, in whole trainings.
        steps: of training and one evaluation everywhere.
        checked: with the checks during training.
        value: mean performance over contexts.
    """

    times: int
    steps: float
    checked: float
    value: float


def points(name: str, world: StepWorld, seed: int) -> list[Point]:
    """Those of a set and a seed, the shortest first."""
    family, axis = name.split("-")[:2]
    found = []
    for method, rows in load_multitask(f"{family}-{axis}").items():
        if method not in METHODS or len(rows.returns) <= seed:
            continue
        record = rows.provenance[seed]
        trained = float(record.get("steps") or record["recipe"]["episodes"] * world.horizon)
        lasts = np.full(world.selection.n, float(world.horizon))
        if family in ONE_PER_STEP:
            lasts = np.clip(rows.returns[seed], 1.0, world.horizon)
        checks = CHECKS if "steps" in record else CHECKS_OF_EPISODES
        steps = trained + float(lasts.sum()) * world.curves.episodes[0]
        performance = world.curves.bounds.normalise(rows.returns[seed])
        found.append(
            Point(
                10 if method.endswith("-x10") else 1,
                steps,
                steps + checks * CHECK_EPISODES * float(lasts.sum()),
                float(performance @ world.selection.weights),
            )
        )
    return sorted(found, key=lambda point: point.times)


def beside(sets: Sets, plays: Plays, strategies: Sequence[str]) -> list[str]:
    """V of these policies and of strategies that have spent as much; of seeds, means."""
    lines = [
        "| set | trained for | units | with checks | V, one policy for all | "
        + " | ".join(f"V, {k}" for k in strategies)
        + " | Oracle Transfer |",
        "|---" * (6 + len(strategies)) + "|",
    ]
    for name, seeds in sets.items():
        every = [points(name, world, s) for s, (world, _) in enumerate(seeds)]
        for k in range(min(len(found) for found in every)):
            some = [found[k] for found in every]
            units = [np.mean([getattr(p, what) / scale.unit
                              for p, (_, scale) in zip(some, seeds, strict=True)])
                     for what in ("steps", "checked")]  # fmt: skip
            cells = [f"{some[0].times} whole", *(f"{u:.1f}" for u in units)]
            cells.append(f"{np.mean([p.value for p in some]):.3f}")
            for strategy in strategies:
                mine = [plays[strategy][name][s].at(p.steps) for s, p in enumerate(some)]
                cells.append(f"{np.mean(mine):.3f}")
            cells.append(f"{np.mean([scale.high for _, scale in seeds]):.3f}")
            lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


@dataclass(frozen=True)
class Found:
    """What looking for one policy for all did to a study of a budget.

    Attributes:
        enough: one policy was not worse than the portfolio when both had cost as much.
        steps: when that was known; infinite: never.
        alone: what the policy that won cost by itself.
        value: V at the end of the budget.
        without: V there of the same study that never looks.
    """

    enough: bool
    steps: float
    alone: float
    value: float
    without: float


def look(play: Play, tries: Sequence[Point], scale: StepScale) -> Found:
    """Whenever the portfolio has cost what one policy of the next length would, train that.

    Where its V is no less than the portfolio's it is kept, and nothing else is trained; else the
    portfolio goes on. So what wins is found within about twice its own steps, and what loses has
    cost no more than the portfolio before it.
    """
    looked, best = 0.0, -np.inf
    for point in tries:
        if 2.0 * point.steps + looked > scale.budget:
            break
        looked += point.steps
        best = max(best, point.value)
        if point.value >= play.at(point.steps):
            return Found(
                True, point.steps + looked, point.steps, point.value, play.at(scale.budget)
            )
    value = max(best, play.at(scale.budget - looked))
    return Found(False, np.inf, looked, value, play.at(scale.budget))


def committee(sets: Sets, plays: Plays, strategy: str) -> list[str]:
    """The rule on every set: how often it says so, when, and what it costs or brings."""
    lines = [
        "| set | one policy is enough | found after, units | it alone costs | V of 30 units | "
        "V without looking | that is the better end |",
        "|---" * 7 + "|",
    ]
    for name, seeds in sets.items():
        both = list(zip(seeds, plays[strategy][name], strict=True))
        every = [
            (look(play, points(name, world, s), scale), scale)
            for s, ((world, scale), play) in enumerate(both)
        ]
        won = [(found, scale) for found, scale in every if found.enough]
        right = sum(found.value >= found.without - 1e-9 for found, _ in every)
        cells = [f"{len(won)} of {len(every)}"]
        for what in ("steps", "alone"):
            mean = (
                np.mean([getattr(found, what) / scale.unit for found, scale in won]) if won else 0
            )
            cells.append(f"{mean:.1f}" if won else "-")
        cells += [f"{np.mean([getattr(f, what) for f, _ in every]):.3f}"
                  for what in ("value", "without")]  # fmt: skip
        cells.append(f"{right} of {len(every)}")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines
