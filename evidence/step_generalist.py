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
from mbtl.benchmark.steps import ONE_PER_STEP, StepWorld

METHODS = ("ppo", "trpo", "ppo-x10", "trpo-x10")
LEAST = 0.001
"""Of V: less is no lead."""
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


def alone(sets: Sets, *, checked: bool) -> dict[str, list[Play]]:
    """The one policy as a play: its lengths one after the other, each trained afresh."""
    found = {}
    for name, seeds in sets.items():
        found[name] = []
        for s, (world, _) in enumerate(seeds):
            tries = points(name, world, s)
            steps = np.array([p.checked if checked else p.steps for p in tries])
            best = np.maximum.accumulate([p.value for p in tries])
            times = np.array([float(p.times) for p in tries])
            found[name].append(Play(steps, best, times))
    return found


def ahead(sets: Sets, plays: Plays, strategy: str, name: str, length: int) -> bool:
    """Whether the one policy of a length is ahead of a strategy at equal steps, mean of seeds."""
    less = []
    for s, (world, scale) in enumerate(sets[name]):
        able = [p for p in points(name, world, s) if p.checked <= scale.budget]
        point = able[length]
        less.append(point.value - plays[strategy][name][s].at(point.checked))
    return bool(np.mean(less) > LEAST)


def race(sets: Sets, plays: Plays, strategy: str) -> dict[str, list[Play]]:
    """A portfolio and one policy for all that take turns: whoever has cost less goes on.

    So whichever wins needs about twice its own steps. V is that of the better one: what both are
    worth together is at least as much. The checks of the one policy are charged.
    """
    found = {}
    for name, seeds in sets.items():
        found[name] = []
        for s, (world, scale) in enumerate(seeds):
            mine, tries = plays[strategy][name][s], points(name, world, s)
            spent, there, looked, best = mine.spent.copy(), [], 0.0, -np.inf
            for point in tries:
                spent[mine.spent > point.checked] += point.checked
                looked += point.checked
                best = max(best, point.value)
                there.append((point.checked + looked, best))
            other = Play(*(np.array(column) for column in zip(*there, strict=True)), mine.lengths)
            moved = Play(spent, mine.value, mine.lengths)
            at = np.sort(np.append(spent, other.spent))
            at = at[at <= scale.budget]
            value = np.array([max(moved.at(steps), other.at(steps)) for steps in at])
            found[name].append(Play(at, value, mine.lengths))
    return found


def verdicts(sets: Sets, plays: Plays, strategy: str) -> list[str]:
    """What the race says and costs, set by set; of seeds, means."""
    lines = [
        "| set | says that one policy is enough | after units | which cost alone | "
        "V of 30 units, both | the portfolio alone | the one policy alone |",
        "|---" * 7 + "|",
    ]
    both, single = race(sets, plays, strategy), alone(sets, checked=True)
    for name, seeds in sets.items():
        said, after, own, ends = 0, [], [], []
        for s, (world, scale) in enumerate(seeds):
            mine = plays[strategy][name][s]
            able = [p for p in points(name, world, s) if _until(p, name, world, s) <= scale.budget]
            if able and able[-1].value >= mine.at(able[-1].checked):
                said += 1
                after.append(_until(able[-1], name, world, s) / scale.unit)
                own.append(able[-1].checked / scale.unit)
            every = (both[name][s], mine, single[name][s])
            ends.append([play.at(scale.budget) for play in every])
        cells = [f"{said} of {len(seeds)}"]
        cells += [f"{np.mean(units):.1f}" if units else "-" for units in (after, own)]
        cells += [f"{v:.3f}" for v in np.mean(ends, axis=0)]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def _until(point: Point, name: str, world: StepWorld, seed: int) -> float:
    """Steps of a race until this try is known: as many for the portfolio, and all tries so far."""
    before = [p.checked for p in points(name, world, seed) if p.times <= point.times]
    return point.checked + float(sum(before))
