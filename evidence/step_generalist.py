"""Tables of `steps.py`: one policy that sees the context and is trained on all, on the same axis.

Each length is a training of its own (`step_policies.py`), whose last weights count. Where there is
none, as of traffic, it is the shipped one, the best of its checks, which are charged. An evaluation
with ten episodes on every context is charged besides, since somebody has to know how good it is.

Notation (shapes): S seeds, K lengths.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from step_tables import Play, Plays, Sets

from mbtl.zoo.actions import Committee
from mbtl.zoo.actions.committee import Sides
from mbtl.zoo.benchmark.multitask import load_multitask
from mbtl.zoo.benchmark.steps import ONE_PER_STEP, OnAll, StepRun, StepWorld

FILE = Path(__file__).parents[1] / "docs/data/one-policy.json"
ROWS = Path(__file__).parents[1] / "docs/data/one-policy-rows.npz"
"""Policies for all contexts, recorded when a live strategy trained them."""
LEAST = 0.001
"""Of V: less is no lead."""
SHIPPED = {"ppo": 1.0, "ppo-x10": 10.0, "trpo": 1.0, "trpo-x10": 10.0}
CHECKS, CHECK_EPISODES = 20, 2
"""Of traffic, per context."""


@dataclass(frozen=True)
class Decided:
    """What a committee said on one seed.

    Attributes:
        side: "all", "specialists" or "nobody" is ahead.
        total: steps that both sides had cost when it said "all".
        alone: of the policies for all, when it said something.
        spent: in the end.
    """

    side: str
    total: float
    alone: float
    spent: float


@dataclass(frozen=True)
class Point:
    """One policy for all contexts.

    Attributes:
        times: length, in whole trainings.
        steps: of training and one evaluation everywhere.
        value: mean performance over contexts.
    """

    times: float
    steps: float
    value: float


def on_all(name: str, seed: int) -> OnAll | None:
    """Rows of policies for all contexts of a set, those that were trained so far."""
    cmdp = "-".join(name.split("-")[:2])
    rows, steps, returns = _rows(), [], []
    while (key := f"{cmdp} {seed} {len(steps)}") in rows:
        steps.append(int(rows[f"{key} steps"]))
        returns.append(rows[key])
    return OnAll(np.array(steps), np.stack(returns)) if steps else None


@cache
def _rows() -> Any:
    return dict(np.load(ROWS)) if ROWS.is_file() else {}


@cache
def _trained() -> Any:
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}


def points(name: str, world: StepWorld, seed: int) -> list[Point]:
    """Those of a set and a seed, the shortest first."""
    family, axis = name.split("-")[:2]
    found = []
    for one in _trained().get(f"{family}-{axis}", []):
        value = one["V"][seed]
        steps = one["steps"] + _evaluation(family, world, value)
        found.append(Point(one["share"], steps, value))
    for method, rows in load_multitask(f"{family}-{axis}").items():
        known = {point.times for point in found}
        if SHIPPED.get(method, 1.0) in known or method not in SHIPPED:
            continue
        record = rows.provenance[seed]
        normalise = world.curves.bounds.normalise
        if "final_mean_return" in record:
            value, trained = float(normalise(record["final_mean_return"])), float(record["steps"])
        else:
            value = float(normalise(rows.returns[seed]).mean())
            episodes = record["recipe"]["episodes"] + CHECKS * CHECK_EPISODES * world.selection.n
            trained = float(episodes * world.horizon)
        steps = trained + _evaluation(family, world, value)
        found.append(Point(SHIPPED[method], steps, value))
    return sorted(found, key=lambda point: point.times)


def _evaluation(family: str, world: StepWorld, value: float) -> float:
    """Steps of ten episodes on every context."""
    episode = world.horizon * (min(value, 1.0) if family in ONE_PER_STEP else 1.0)
    return episode * world.selection.n * world.curves.episodes[0]


def beside(sets: Sets, plays: Plays, strategies: Sequence[str]) -> list[str]:
    """V of these policies and of strategies that have spent as much; of seeds, means."""
    lines = [
        "| set | trained for | units | V, one policy for all | "
        + " | ".join(f"V, {k}" for k in strategies)
        + " | Oracle Transfer |",
        "|---" * (5 + len(strategies)) + "|",
    ]
    for name, seeds in sets.items():
        every = [points(name, world, s) for s, (world, _) in enumerate(seeds)]
        for k in range(min(len(found) for found in every)):
            some = [found[k] for found in every]
            units = np.mean([p.steps / sc.unit for p, (_, sc) in zip(some, seeds, strict=True)])
            cells = [f"{Fraction(some[0].times)} whole", f"{units:.1f}"]
            cells.append(f"{np.mean([p.value for p in some]):.3f}")
            for strategy in strategies:
                mine = [plays[strategy][name][s].at(p.steps) for s, p in enumerate(some)]
                cells.append(f"{np.mean(mine):.3f}")
            cells.append(f"{np.mean([scale.high for _, scale in seeds]):.3f}")
            lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def alone(sets: Sets) -> dict[str, list[Play]]:
    """The one policy as a play: its lengths one after the other, each trained afresh."""
    found = {}
    for name, seeds in sets.items():
        found[name] = []
        for s, (world, _) in enumerate(seeds):
            tries = points(name, world, s)
            steps = np.array([p.steps for p in tries])
            best = np.maximum.accumulate([p.value for p in tries])
            times = np.array([p.times for p in tries])
            found[name].append(Play(steps, best, times))
    return found


def ahead(sets: Sets, plays: Plays, strategy: str, name: str, units: float) -> bool:
    """Whether the last such policy within some units is ahead of a strategy at equal steps."""
    less = []
    for s, (world, scale) in enumerate(sets[name]):
        able = [p for p in points(name, world, s) if p.steps <= units * scale.unit]
        if able:
            less.append(able[-1].value - plays[strategy][name][s].at(able[-1].steps))
    return bool(less and np.mean(less) > LEAST)


def race(sets: Sets, plays: Plays, strategy: str) -> dict[str, list[Play]]:
    """A portfolio and one policy for all that take turns: whoever has cost less goes on.

    The next length is trained once the portfolio has cost as much. V is that of the better one:
    what both are worth together is at least as much.
    """
    found = {}
    for name, seeds in sets.items():
        found[name] = []
        for s, (world, scale) in enumerate(seeds):
            mine, tries = plays[strategy][name][s], points(name, world, s)
            spent, there, looked, best = mine.spent.copy(), [], 0.0, -np.inf
            for point in tries:
                spent[mine.spent > point.steps] += point.steps
                looked += point.steps
                best = max(best, point.value)
                there.append((point.steps + looked, best))
            other = Play(*(np.array(column) for column in zip(*there, strict=True)), mine.lengths)
            moved = Play(spent, mine.value, mine.lengths)
            at = np.sort(np.append(spent, other.spent))
            at = at[at <= scale.budget]
            value = np.array([max(moved.at(steps), other.at(steps)) for steps in at])
            found[name].append(Play(at, value, mine.lengths))
    return found


def decided(rule: Committee, world: StepWorld, run: StepRun, budget: float) -> Decided:
    """What a committee has said, and what that had cost; steps."""
    sides = Sides.of(run.trail)
    winner, then = rule.decision(world.problem(budget), run.trail, sides)
    alone = 0.0 if then is None else then.steps
    total = alone + sides.ours.spent if winner == "all" else 0.0
    return Decided(winner or "nobody", total, alone, run.trail.spent)


def verdicts(
    sets: Sets, plays: Plays, said: Mapping[str, list[Decided]], committee: str, specialists: str
) -> list[str]:
    """What a committee says on each set and what that costs; of seeds, means."""
    lines = [
        "| set | one policy is enough | specialists are ahead | nothing | units until it said that "
        "one policy is enough | of them for the one policy | units until it said that specialists "
        "are ahead, for the one policy | units paid in all | V, committee | V, specialists alone "
        "with 30 units |",
        "|---" * 10 + "|",
    ]
    for name, seeds in sets.items():
        found, cells = said[name], []
        units = [scale.unit for _, scale in seeds]
        for side in ("all", "specialists", "nobody"):
            cells.append(f"{sum(one.side == side for one in found)} of {len(found)}")
        for side, what in (("all", "total"), ("all", "alone"), ("specialists", "alone")):
            some = [getattr(one, what) / unit for one, unit in zip(found, units, strict=True)
                    if one.side == side]  # fmt: skip
            cells.append(f"{np.mean(some):.1f}" if some else "-")
        paid = np.mean([one.spent / unit for one, unit in zip(found, units, strict=True)])
        cells.append(f"{paid:.1f}")
        for strategy in (committee, specialists):
            ends = [play.at(scale.budget) for play, (_, scale)
                    in zip(plays[strategy][name], seeds, strict=True)]  # fmt: skip
            cells.append(f"{np.mean(ends):.3f}")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines
