import math

import gymnasium
import numpy as np
import pytest
from played import begun

from mbtl.errors import ContextMismatch, InvalidInput, UnknownName
from mbtl.zoo.cmdps.cartpole import ANGLE_LIMIT, CartPole, derive


@pytest.mark.parametrize("seed", range(3))
def test_agrees_step_for_step_with_gymnasium_at_the_nominal_context(seed):
    ours, theirs = CartPole({"length": 0.5}, visibility="hidden"), gymnasium.make("CartPole-v1")
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    rng = np.random.default_rng(seed)
    np.testing.assert_array_equal(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0])
    for _ in range(200):
        action = rng.integers(2)
        got, want = ours.step(action), theirs.step(action)
        np.testing.assert_allclose(got[0], want[0], rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(ours.state, theirs.unwrapped.state, rtol=1e-9, atol=1e-12)
        assert got[1:4] == want[1:4]
        if got[2]:
            np.testing.assert_array_equal(ours.reset()[0], theirs.reset()[0])


def test_reference_length_and_pole_mass_act_only_in_one_denominator():
    short = derive({**CartPole.FEATURES, "length": 0.05}, "reference")
    assert (short.length, short.total_mass, short.pole_moment) == (0.05, 1.1, 0.05)
    heavy = derive({**CartPole.FEATURES, "masspole": 1.0}, "reference")
    assert (heavy.pole_mass, heavy.total_mass, heavy.pole_moment) == (1.0, 1.1, 0.05)


@pytest.mark.parametrize(
    ("feature", "value", "total_mass", "pole_moment"),
    [("masscart", 10.0, 10.1, 0.05), ("length", 5.0, 1.1, 0.5), ("masspole", 1.0, 2.0, 0.5)],
)
def test_derived_constants_at_the_corners(feature, value, total_mass, pole_moment):
    constants = derive({**CartPole.FEATURES, feature: value})
    assert constants.total_mass == pytest.approx(total_mass, rel=1e-15)
    assert constants.pole_moment == pytest.approx(pole_moment, rel=1e-15)


def run_balanced(env):
    """Hold the state upright so that only the clock can end the episode."""
    env.reset(seed=0)
    for t in range(1, 10_000):
        env.state = (0.0, 0.0, 0.0, 0.0)
        _, _, terminated, truncated, _ = env.step(t % 2)
        if terminated or truncated:
            return t, terminated, truncated
    raise AssertionError("the episode never ended")


def test_the_horizon_is_a_truncation_by_default_and_terminal_as_in_the_reference():
    assert run_balanced(CartPole()) == (500, False, True)
    assert run_balanced(CartPole(time_limit="terminal")) == (500, True, False)
    assert run_balanced(CartPole(horizon=7)) == (7, False, True)


@pytest.mark.parametrize(
    "state", [(2.39, 5.0, 0.0, 0.0), (-2.39, -5.0, 0.0, 0.0), (0.0, 0.0, ANGLE_LIMIT - 0.01, 2.0)]
)
def test_leaving_the_track_or_falling_is_terminal_and_still_pays(state):
    env = begun(CartPole())
    env.state = state
    _, reward, terminated, truncated, _ = env.step(1)
    assert (reward, terminated, truncated) == (1.0, True, False)
    with pytest.raises(InvalidInput, match=r"call reset\(\)"):
        env.step(1)
    env.reset()
    with pytest.raises(InvalidInput, match="got 2"):
        env.step(2)


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda: CartPole({"lenght": 1.0}), UnknownName, "Did you mean 'length'"),
        (lambda: CartPole({"length": 0.0}), ContextMismatch, "finite numbers > 0"),
        (lambda: CartPole({"length": math.nan}), ContextMismatch, "finite numbers > 0"),
        (lambda: CartPole({"length": "long"}), ContextMismatch, "finite numbers > 0"),
        (lambda: CartPole(unit={"lenght": 1.0}), UnknownName, "Did you mean 'length'"),
        (lambda: CartPole(visibility="seen"), UnknownName, "visibility"),
        (lambda: CartPole(physics="real"), UnknownName, "physics"),
        (lambda: CartPole(time_limit="never"), UnknownName, "time limit"),
        (lambda: CartPole(horizon=0), InvalidInput, "horizon"),
        (lambda: CartPole().step(0), InvalidInput, "call reset"),
    ],
)
def test_mistakes_are_named(call, error, match):
    with pytest.raises(error, match=match):
        call()
