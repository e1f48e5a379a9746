"""Changing the policy within an episode: what parts show, Bayes by hand, and who plays on."""

from types import SimpleNamespace

import numpy as np
import pytest

import mbtl
from mbtl.errors import InvalidInput
from mbtl.objective import Bounds
from mbtl.portfolio import Portfolio

STEPS = 10
PAY = np.array([[2.0, 0.0], [1.0, 1.0], [0.0, 3.0]])
"""Reward of each action in each context, per step."""


class Paying:
    """Pays by action and context, after step `late`; an observation is the context, with noise."""

    def __init__(self, context, late=0, sign=1.0):
        self.x, self.late, self.sign = int(context["x"]), late, sign

    def reset(self, *, seed=None):
        self.t, self.luck = 0, np.random.default_rng(seed)
        return self.observation(), {}

    def observation(self):
        return np.array([self.x + self.luck.normal(scale=0.1)])

    def step(self, action):
        self.t += 1
        reward = self.sign * PAY[action, self.x] * (self.t > self.late)
        return self.observation(), reward, self.t == STEPS, False, {}

    def close(self):
        pass


def portfolio(direction="maximize", steps=STEPS):
    sign = 1.0 if direction == "maximize" else -1.0
    returns = sign * steps * PAY
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 2})
    bounds = Bounds(min(0.0, 30.0 * sign), max(0.0, 30.0 * sign), direction)
    policies = {
        i: SimpleNamespace(predict=lambda seen, deterministic=True, i=i: (i, None))
        for i in range(3)
    }
    return Portfolio(space, (0, 0, 1), returns, bounds, in_memory=policies)


def serve(serving, env):
    """The return, and which policy acted in each step."""
    observation, _ = env.reset(seed=0)
    total, who, over = 0.0, [], False
    while not over:
        who.append(serving.next)
        action, _ = serving.policy.predict(observation)
        seen, reward, over, _, _ = env.step(action)
        serving.step(observation, action, reward)
        observation, total = seen, total + reward
    serving.observe(total)
    return total, who


def test_signs_are_means_of_parts_and_a_part_cut_short_has_no_features():
    signs = portfolio().signs(Paying, every=4, episodes=3, features=lambda seen, done: seen.mean(0))
    assert signs.mean.shape == signs.deviation.shape == (3, 2, 3, 2)
    np.testing.assert_allclose(signs.mean[2, 1, :, 0], [12.0, 12.0, 6.0])
    np.testing.assert_allclose(signs.to_go[2, 1], [30.0, 18.0, 6.0, 0.0])
    np.testing.assert_allclose(signs.mean[:, 1, :2, 1], 1.0, atol=0.2)
    assert np.isnan(signs.mean[:, :, 2, 1]).all()
    assert (signs.deviation[..., 0] == 0.0).all()
    assert (signs.deviation[:, :, :2, 1] > 0.0).all()


@pytest.mark.parametrize("direction", ["maximize", "minimize"])
def test_the_rewards_of_a_part_change_the_policy_within_the_episode(direction):
    served, sign = portfolio(direction), 1.0 if direction == "maximize" else -1.0
    make_env = lambda context: Paying(context, sign=sign)  # noqa: E731
    serving = served.adaptive(signs=served.signs(make_env, every=4))
    total, who = serve(serving, make_env({"x": 0.0}))
    assert who == [2] * 4 + [0] * 6  # the best in the dark, until it earns nothing
    assert total == sign * 12.0
    assert serving.next == 0  # in the next episode from its start


def test_parts_follow_bayes_and_their_return_does_not_count_twice():
    served = portfolio()
    serving = served.adaptive(signs=served.signs(Paying, every=4))
    for _ in range(4):
        serving.step(np.zeros(1), 2, 2.6)  # 10.4 of policy 2: 0 in one context, 12 in the other
    deviation = 0.03 * 12.0  # the blur; this simulator pays without luck
    normal = np.exp(-0.5 * ((10.4 - np.array([0.0, 12.0])) / deviation) ** 2)
    odds = 0.99 * normal / (np.sqrt(2 * np.pi) * deviation) + 0.01 / 12.0
    np.testing.assert_allclose(serving.chances, odds / odds.sum())
    before = serving.chances
    serving.observe(0.0)  # by itself, the return that policy 2 has in the other context
    np.testing.assert_array_equal(serving.chances, before)
    assert serving.played == [(2, 0.0)]
    serving.observe(0.0, policy=2)  # an episode without its steps
    assert serving.chances[0] > before[0]


def test_features_tell_what_rewards_show_too_late():
    served, late = portfolio(steps=4), STEPS - 4
    make_env = lambda context: Paying(context, late=late)  # noqa: E731
    blind = served.adaptive(signs=served.signs(make_env, every=2))
    assert serve(blind, make_env({"x": 0.0}))[0] == 2 * 2.0
    signs = served.signs(make_env, every=2, features=lambda seen, done: seen.mean(axis=0))
    total, who = serve(served.adaptive(signs=signs), make_env({"x": 0.0}))
    assert (total, who[2:]) == (4 * 2.0, [0] * 8)


def test_what_is_no_part_is_refused():
    served = portfolio()
    with pytest.raises(InvalidInput, match="a part has 1 step or more"):
        served.signs(Paying, every=0)
    with pytest.raises(InvalidInput, match="must be finite numbers"):
        served.signs(Paying, every=2, features=lambda seen, done: [np.nan])
    with pytest.raises(InvalidInput, match=r"add up to 11\.67 where returns are 4\.667"):
        portfolio(steps=4).signs(Paying)
    counts = iter(range(1, 1000))
    with pytest.raises(InvalidInput, match="as many features, got 1, 2"):
        served.signs(Paying, every=5, features=lambda seen, done: np.ones(next(counts) % 2 + 1))
    without = served.adaptive()
    without.step(np.zeros(1), 2, 0.0)
    np.testing.assert_array_equal(without.chances, [0.5, 0.5])
