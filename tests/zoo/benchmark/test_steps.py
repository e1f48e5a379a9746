"""Steps on known curves: every price in closed form, V routed as everywhere, nothing free."""

import numpy as np
import pytest
from step_measure import StepScale, geometric_mean, paired_interval

from mbtl.contexts import ContextSpace, Linear
from mbtl.errors import InvalidInput
from mbtl.objective import Bounds
from mbtl.routing import last_route
from mbtl.zoo.actions.base import Evaluate, Extend, Policy, Start, Stop, Trail
from mbtl.zoo.benchmark.curves import TransferCurves
from mbtl.zoo.benchmark.steps import StepWorld, replay_steps, serving

SPACE = ContextSpace.grid({Linear("x", 0.0, 2.0): [0.0, 1.0, 2.0]})
LENGTHS = [100, 200, 400]


def curves(name="pendulum-toy", lasted=(400, 400, 400)):
    """Source s at mark l: 40 + 10 l at home, 10 less per grid step; one less when fresh."""
    apart = np.abs(np.subtract.outer(np.arange(3), np.arange(3)))
    mean = 10.0 * np.arange(1, 4)[:, None, None] - 10.0 * apart + 30.0
    episodes = np.stack([mean, mean, mean - 1.0, mean - 1.0], axis=-1)
    return TransferCurves.of_episodes(
        np.stack([episodes, episodes]), np.array(lasted), LENGTHS,
        name=name, space=SPACE, bounds=Bounds(0.0, 100.0), theta=0.01,
    )  # fmt: skip


class Script:
    """Does what it was told, in order."""

    name = "script"

    def __init__(self, *actions):
        self.actions, self.seen = actions, []

    def decide(self, problem, trail, rng):
        self.seen.append(trail)
        return self.actions[len(self.seen) - 1] if len(self.seen) <= len(self.actions) else Stop()


def test_a_training_an_extension_and_an_evaluation_cost_their_steps():
    world = StepWorld(curves(), 0)
    script = Script(
        Start(1, 0), Evaluate(Policy(0, 0), (0, 1, 2)), Extend(0, 2), Evaluate(Policy(0, 2), (1,))
    )
    run = replay_steps(script, world, 1e6)
    episode = 2 * 200  # two episodes of the half that is seen, at the horizon of pendulum
    assert run.spent.tolist() == [100 + 3 * episode, 400 + 4 * episode]
    assert run.evaluation_share == pytest.approx(4 * episode / (400 + 4 * episode))
    # after mark 0: 30, 40, 30; later the policy of mark 2, seen at home alone, counts everywhere
    assert run.value.tolist() == pytest.approx([(29 + 39 + 29) / 300, (49 + 59 + 49) / 300])


def test_an_episode_of_cartpole_costs_its_return_and_a_training_that_ended_no_more():
    world = StepWorld(curves("cartpole-toy", lasted=(400, 150, 400)), 0)
    run = replay_steps(Script(Start(1, 2), Evaluate(Policy(0, 1), (0,))), world, 1e6)
    # checks every 400 / 50 = 8 steps, ten episodes each: 12 at a return of 40, 6 more at 50
    assert run.spent.tolist() == [150 + 10 * (12 * 40 + 6 * 50) + 2 * 40]
    assert run.trail.trainings[0].ended
    with pytest.raises(InvalidInput, match="unless it has ended"):
        world.extend(world.start(Trail(SPACE.steps), 1, 1), 0, 2)


def test_the_best_policy_so_far_is_charged_its_checks():
    last, best = (StepWorld(curves(), 0, kind).training_price[-1, 0] for kind in ("last", "best"))
    assert (last, best) == (400.0, 400.0 + 50 * 10 * 200)


def test_what_goes_over_the_budget_comes_too_late():
    run = replay_steps(
        Script(Start(0, 0), Evaluate(Policy(0, 0), (0,))), StepWorld(curves(), 0), 499
    )
    assert not len(run.value)
    assert run.trail.spent == 100


def test_a_strategy_sees_only_what_it_paid_for():
    script = Script(Start(0, 1), Evaluate(Policy(0, 1), (2,)), Evaluate(Policy(0, 0), (0,)))
    replay_steps(script, StepWorld(curves(), 0), 1e6)
    rows = script.seen[-1].rows
    assert np.isnan(rows).tolist() == [[True, True, False], [False, True, True]]
    assert rows[0, 2] == pytest.approx(0.30)
    assert not np.isfinite(script.seen[1].rows).any()


@pytest.mark.parametrize(
    ("actions", "rule"),
    [
        ((Start(0, 0), Start(0, 1)), "without one"),
        ((Start(0, 3),), "index of 3 marks"),
        ((Start(0, 0), Evaluate(Policy(0, 1), (0,))), "no policy at mark 1"),
        ((Start(0, 0), *(Evaluate(Policy(0, 0), (0,)),) * 2), "not been seen on"),
    ],
)
def test_impossible_actions_are_refused_with_the_rule(actions, rule):
    with pytest.raises(InvalidInput, match=rule):
        replay_steps(Script(*actions), StepWorld(curves(), 0), 1e6)


def test_a_family_whose_episodes_nobody_knows_asks_for_the_horizon():
    with pytest.raises(InvalidInput, match="horizon"):
        StepWorld(curves("mine"), 0)
    assert StepWorld(curves("mine"), 0, horizon=7).horizon == 7


def test_routes_are_those_of_portfolios():
    rng = np.random.default_rng(0)
    steps = np.arange(20.0)[:, None]
    for _ in range(20):
        sources = rng.integers(0, 20, 6)
        rows = np.round(rng.uniform(0, 1, (6, 20)), 1)  # with ties
        rows[rng.uniform(size=rows.shape) < 0.1] = np.nan
        rows[0] = 0.0
        assert np.array_equal(
            rows[serving(rows, sources, steps), np.arange(20)],
            rows[last_route(rows, sources.tolist(), steps), np.arange(20)],
        )
        assert np.array_equal(
            sources[serving(rows, sources, steps)],
            sources[last_route(rows, sources.tolist(), steps)],
        )


def test_units_levels_and_area_have_closed_forms():
    made = StepScale(1000.0, 5000.0, 0.2, 0.7, *np.empty((3, 0)))
    spent, value = np.array([500.0, 3000.0]), np.array([0.45, 0.7])
    assert made.to_levels(spent, value).tolist() == [3.0, 3.0, 3.0]
    assert made.to(spent, value, 0.5) == 0.5
    # half the way from 0.5 to 3 units, all of it from there to 30, of log(300) in all
    closed = (0.5 * np.log(6) + np.log(10)) / np.log(300)
    assert made.area(spent, value) == pytest.approx(closed, abs=0.01)
    assert made.to_levels(spent[:1], value[:1])[0] == np.inf


def test_a_unit_is_a_whole_training_with_its_evaluation():
    scale = StepScale.of(StepWorld(curves(), 0))
    assert scale.unit == 400 + 3 * 2 * 200
    assert scale.oracle_trained[:2].tolist() == [400, 800]
    assert scale.oracle_spent[:2].tolist() == [scale.unit, 2 * scale.unit]
    assert scale.paper == 400 + 3 * 100 * 200  # a hundred episodes per target
    assert scale.high == pytest.approx(0.59)
    assert scale.low == pytest.approx((59 * 3 + 49 * 4 + 39 * 2) / 900)
    assert scale.oracle_spent.tolist() == [1600.0, 3200.0, 4800.0]


def test_intervals_are_paired_and_seeds_are_drawn_within_a_set():
    mean, low, high = paired_interval({"a": np.array([1.0, 2.0, 3.0]), "b": np.full(3, 4.0)})
    assert mean == pytest.approx(3.0)
    assert (low, high) == pytest.approx((2.5, 3.5))  # thrice the least, thrice the most of "a"
    assert geometric_mean([1.0, 4.0]) == pytest.approx(2.0)
