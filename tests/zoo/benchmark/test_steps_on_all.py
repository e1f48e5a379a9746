"""Policies for all contexts in a replay: charged like all else, and routed where they serve."""

from dataclasses import dataclass

import numpy as np
import pytest

from mbtl.contexts import ContextSpace, Linear
from mbtl.errors import InvalidInput
from mbtl.objective import Bounds
from mbtl.zoo.actions import Committee, Evaluate, FixedLength, Policy, Start, StartOn, Stop
from mbtl.zoo.actions.base import Trail
from mbtl.zoo.actions.committee import Sides
from mbtl.zoo.actions.evaluation import EVERYWHERE
from mbtl.zoo.benchmark.curves import TransferCurves
from mbtl.zoo.benchmark.steps import OnAll, StepWorld, replay_steps

N, WHOLE, EPISODE = 21, 4_000, 200
SPACE = ContextSpace.grid({Linear("x", 0.0, 1.0): N})
EVERY = tuple(range(N))
MARKS = np.array([1_000 * 2**i for i in range(8)])


def world(levels, slope=4.0, less=0.0):
    """Specialists return 80 at home and `slope` less per grid step; the others `levels` everywhere.

    In fresh episodes those return `less` less.
    """
    apart = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    rows = np.repeat((80.0 - slope * apart)[None, :, :, None], 2, axis=-1)
    curves = TransferCurves.of_episodes(
        np.stack([rows, rows]), np.full(N, WHOLE), [WHOLE],
        name="pendulum-toy", space=SPACE, bounds=Bounds(0.0, 100.0), theta=0.01,
    )  # fmt: skip
    wave = np.cos(np.arange(N))
    seen = np.stack([level + wave for level in levels])
    on_all = OnAll(MARKS[: len(levels)], np.stack([seen, seen - less], axis=1))
    return StepWorld(curves, 0, on_all=on_all)


@dataclass
class Script:
    actions: tuple
    name: str = "script"

    def decide(self, problem, trail, rng):
        done = len(trail.trainings) + len(trail.policies)
        return self.actions[done] if done < len(self.actions) else Stop()


def test_a_policy_for_all_costs_its_steps_and_serves_where_it_is_best():
    script = Script(
        (
            Start(0, 0),
            Evaluate(Policy(0, 0), EVERY),
            StartOn(EVERY, 1),
            Evaluate(Policy(1, 1), EVERY),
        )
    )
    toy = world([10.0, 60.0], less=2.0)
    run = replay_steps(script, toy, 1e6)
    row = N * EPISODE
    assert run.spent.tolist() == [WHOLE + row, WHOLE + 2 * row + 2_000]
    specialist, everyone = 80.0 - 4.0 * np.arange(N), 60.0 + np.cos(np.arange(N))
    better = everyone > specialist
    assert 0 < better.sum() < N
    fresh = np.where(better, everyone - 2.0, specialist)  # routed by what was seen
    assert run.value[-1] == pytest.approx(fresh.mean() / 100)
    assert run.trail.trainings[1].source == 10
    assert toy.problem(1e6).lengths_on_all.tolist() == [1_000, 2_000]


def test_what_has_no_rows_is_refused():
    toy, trail = world([10.0, 60.0]), Trail(SPACE.steps)
    with pytest.raises(InvalidInput, match="got 2 contexts at length 0"):
        toy.start_on(trail, (0, 1), 0)
    with pytest.raises(InvalidInput, match="index of 2 marks, got 2"):
        toy.start_on(trail, EVERY, 2)
    begun = toy.start_on(trail, EVERY, 0)
    with pytest.raises(InvalidInput, match="once at a length"):
        toy.start_on(begun, EVERY, 0)
    bare = StepWorld(toy.curves, 0)
    assert not len(bare.problem(1e6).lengths_on_all)
    with pytest.raises(InvalidInput, match="its rows are given"):
        bare.start_on(trail, EVERY, 0)


def to(run, level):
    """Steps until V has a level."""
    return run.spent[np.flatnonzero(run.value >= level - 1e-9)[0]]


@pytest.mark.parametrize("slope", [1.0, 4.0, 12.0])
@pytest.mark.parametrize(
    "levels",
    [
        [20.0, 30.0, 40.0, 70.0, 75.0, 76.0, 77.0, 77.0],
        [79.0] * 8,
        [10.0] * 8,
        [60.0, 62.0, 64.0, 66.0, 68.0, 70.0, 72.0, 74.0],
    ],
)
def test_v_of_either_side_costs_twice_its_own_steps_at_most(levels, slope):
    """While nobody is given up: V of each side at s steps is there at 2 s, and one piece more."""
    toy, budget = world(levels, slope), 200_000
    rule = Committee(FixedLength("mbtl"), 99, EVERYWHERE)
    both = replay_steps(rule, toy, budget)
    largest = WHOLE + 2 * N * EPISODE
    alone = replay_steps(FixedLength("mbtl"), toy, budget)
    for steps, level in zip(alone.spent, np.maximum.accumulate(alone.value), strict=True):
        if 2 * steps + largest < both.spent[-1]:
            assert to(both, level) <= 2 * steps + largest
    paid = 0.0
    for i, level in enumerate(levels):
        paid += MARKS[i] + N * EPISODE  # evaluated everywhere at most
        if 2 * paid + largest < both.spent[-1]:
            assert to(both, (level + np.cos(np.arange(N)).mean()) / 100) <= 2 * paid + largest


@pytest.mark.parametrize(("levels", "side"), [([79.0] * 8, "all"), ([10.0] * 8, "specialists")])
def test_the_better_side_gets_what_is_left(levels, side):
    toy, rule = world(levels, slope=12.0), Committee(FixedLength("mbtl"), evaluation=EVERYWHERE)
    run = replay_steps(rule, toy, 500_000)
    winner, then = rule.decision(toy.problem(500_000), run.trail)
    sides = Sides.of(run.trail)
    assert winner == side
    if side == "all":
        assert sides.ours.spent <= 2 * then.steps
        assert sides.spent_on_all > 3 * then.steps
    else:
        assert sides.spent_on_all == then.steps
        assert sides.ours.spent > 3 * then.steps
