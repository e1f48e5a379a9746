"""Serving a context that is not told: Bayes by hand, and exploration that pays."""

import numpy as np
import pytest

import mbtl
from mbtl.errors import InvalidInput
from mbtl.objective import Bounds
from mbtl.portfolio import Portfolio
from mbtl.portfolio import adaptive as module


def portfolio(means, deviation=5.0, direction="maximize"):
    """Policies whose single episodes lie this far from their means, raw units of 0 to 100."""
    means = np.asarray(means, dtype=float)
    each = [row[:, None] + deviation * np.tile([-1.0, 1.0], 500) for row in means]
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, means.shape[1] - 1.0): means.shape[1]})
    sources = tuple(i % means.shape[1] for i in range(len(means)))
    return Portfolio(space, sources, means, Bounds(0.0, 100.0, direction), each)


def test_chances_follow_bayes_and_forgetting_goes_back_to_the_prior():
    serving = portfolio([[20.0, 30.0], [50.0, 0.0]]).adaptive()
    np.testing.assert_allclose(serving.chances, [0.5, 0.5])
    np.testing.assert_allclose(serving.expected, [25.0, 25.0])
    serving.observe(24.0, policy=0)
    blur = 0.03 * 0.5  # of the range of performance
    deviation = np.hypot(0.05, blur)
    normal = np.exp(-0.5 * ((0.24 - np.array([0.2, 0.3])) / deviation) ** 2)
    odds = 0.99 * normal / (np.sqrt(2 * np.pi) * deviation) + 0.01 / 0.5
    np.testing.assert_allclose(serving.chances, odds / odds.sum(), rtol=1e-3)
    assert serving.context == {"x": 0.0}
    assert serving.next == 1
    drifting = portfolio([[20.0, 30.0], [50.0, 0.0]]).adaptive(forget=0.5)
    drifting.observe(24.0, policy=0)
    np.testing.assert_allclose(drifting.chances, (serving.chances + 0.5) / 2)


def test_it_tries_what_tells_contexts_apart_while_that_can_still_be_used():
    # policy 0 is the best that one can do blindly, and shows nothing of the context
    returns = [[50.0, 50.0], [70.0, 20.0], [20.0, 70.0]]
    assert portfolio(returns).adaptive(episodes=1).next == 0
    serving = portfolio(returns).adaptive()
    assert serving.next == 1
    serving.observe(20.0)
    assert serving.next == 2


@pytest.mark.parametrize("direction", ["maximize", "minimize"])
def test_ten_episodes_reach_what_telling_the_context_does(direction):
    x = np.arange(11.0)
    means = np.array([80.0 - 6.0 * np.abs(x - s) for s in (1, 5, 9)])
    means = means if direction == "maximize" else 100.0 - means
    served = portfolio(means, direction=direction)
    rng, reached = np.random.default_rng(0), []
    for true in range(11):
        serving = served.adaptive()
        for _ in range(10):
            serving.observe(float(rng.normal(means[serving.next, true], 5.0)))
        reached.append(served.performance[serving.played[-1][0], true])
    told = served.performance.max(axis=0).mean()
    single = served.performance.mean(axis=1).max()
    assert np.mean(reached) > single + 0.8 * (told - single)


def test_without_episodes_returns_count_as_exact_but_for_a_blur():
    exact = Portfolio(
        mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 2}),
        (0, 1), np.array([[10.0, 20.0], [30.0, 5.0]]), Bounds(0.0, 100.0),
    )  # fmt: skip
    serving = exact.adaptive()
    serving.observe(20.1, policy=0)
    assert serving.chances[1] > 0.9
    assert module.deviations((), (2, 2), 1.0).sum() == 0.0


def test_wrong_numbers_are_refused_and_teach_nothing():
    served = portfolio([[20.0, 30.0], [50.0, 0.0]])
    with pytest.raises(InvalidInput, match="episodes must be 1 or more"):
        served.adaptive(episodes=0)
    serving = served.adaptive()
    with pytest.raises(InvalidInput, match="finite return"):
        serving.observe(float("nan"))
    with pytest.raises(InvalidInput, match="finite return"):
        serving.observe(None)
    with pytest.raises(InvalidInput, match="finite return"):
        serving.observe(np.array([1.0]))
    with pytest.raises(InvalidInput, match="policy of 0 to 1"):
        serving.observe(1.0, policy=2)
    assert serving.played == []


def test_a_context_outside_is_refused_or_judged_at_the_nearest_one_inside():
    served = portfolio([[20.0, 30.0], [50.0, 0.0]])
    with pytest.raises(mbtl.errors.ContextMismatch):
        served.explain({"x": 7.0})
    choice = served.explain({"x": 7.0}, outside="nearest")
    assert (choice.policy, choice.instead) == (0, {"x": 1.0})
    assert choice.predicted_return == served.explain({"x": 1.0}).predicted_return
    assert choice.explanation.startswith("Outside of the contexts, judged at the nearest one")
    assert served.explain({"x": 1.0}, outside="nearest").instead is None
    with pytest.raises(mbtl.errors.UnknownName, match="nearest"):
        served.policy_for({"x": 1.0}, outside="clip")
