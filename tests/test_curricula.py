"""Rules of curricula: closed forms, limits, and what is refused."""

import numpy as np
import pytest

from mbtl.curricula import (
    CURRICULA,
    Learnability,
    Outcomes,
    Regret,
    curriculum_named,
    learnability,
    ranked,
)
from mbtl.errors import InvalidInput, UnknownName


def outcomes(performance=(0.0, 0.5, 1.0), best=None, success=None, age=(0, 0, 0)):
    performance = np.array(performance)
    return Outcomes(
        performance,
        performance if best is None else np.array(best),
        None if success is None else np.array(success),
        np.array(age),
    )


def test_learnability_is_largest_where_half_of_the_episodes_succeed():
    found = learnability(np.array([0.0, 0.25, 0.5, 1.0]))
    np.testing.assert_allclose(found, [0.0, 3 / 16, 1 / 4, 0.0])


def test_performance_beyond_the_bounds_counts_as_at_them():
    np.testing.assert_array_equal(learnability(np.array([-0.5, 1.3])), [0.0, 0.0])


def test_episodes_go_where_the_policy_sometimes_succeeds_and_half_of_them_evenly():
    # p (1 - p) = 0, 3/16, 1/4: of 7/16 in all
    found = Learnability().weights(outcomes(success=(1.0, 0.25, 0.5)))
    np.testing.assert_allclose(found, [1 / 6, 1 / 6 + 3 / 14, 1 / 6 + 4 / 14])


def test_without_success_performance_stands_for_it_and_may_do_so_everywhere():
    performance = (0.0, 0.25, 0.5)
    expected = [0.0, 3 / 7, 4 / 7]
    rule = Learnability(uniform=0.0)
    np.testing.assert_allclose(rule.weights(outcomes(performance)), expected)
    with_success = outcomes(performance, success=(0.5, 0.0, 0.0))
    np.testing.assert_allclose(rule.weights(with_success), [1.0, 0.0, 0.0])
    everywhere = Learnability(uniform=0.0, of_success=False)
    np.testing.assert_allclose(everywhere.weights(with_success), expected)


def test_where_nothing_can_be_learnt_contexts_are_alike():
    found = Learnability(uniform=0.0).weights(outcomes(success=(0.0, 0.0, 1.0)))
    np.testing.assert_allclose(found, np.full(3, 1 / 3))


def test_ranks_weigh_by_their_power_and_equal_scores_share_one():
    # at temperature 1/2: 1, 1/4, 1/9
    found = ranked(np.array([5.0, 9.0, 7.0]), temperature=0.5)
    np.testing.assert_allclose(found, np.array([4.0, 36.0, 9.0]) / 49.0)
    found = ranked(np.array([3.0, 3.0, 1.0]), temperature=1.0)
    np.testing.assert_allclose(found, np.array([3.0, 3.0, 1.0]) / 7.0)
    np.testing.assert_allclose(ranked(np.zeros(4), temperature=0.1), np.full(4, 0.25))


def test_regret_is_the_best_return_less_the_present_one():
    # regrets .1, .6, .3: ranks 3, 1, 2
    rule = Regret(uniform=0.0, temperature=1.0, staleness=0.0)
    found = rule.weights(outcomes((0.8, 0.2, 0.4), best=(0.9, 0.8, 0.7)))
    np.testing.assert_allclose(found, np.array([2.0, 6.0, 3.0]) / 11.0)


def test_contexts_not_played_for_long_get_their_share():
    rule = Regret(uniform=0.5, temperature=1.0, staleness=0.4)
    found = rule.weights(outcomes((0.8, 0.2, 0.4), best=(0.9, 0.8, 0.7), age=(6, 0, 2)))
    ranks, ages = np.array([2.0, 6.0, 3.0]) / 11.0, np.array([0.75, 0.0, 0.25])
    np.testing.assert_allclose(found, 0.5 / 3 + 0.5 * (0.6 * ranks + 0.4 * ages))
    assert Regret(staleness=1.0).weights(outcomes()) == pytest.approx(np.full(3, 1 / 3))


@pytest.mark.parametrize("name", CURRICULA)
def test_weights_are_shares_of_any_outcomes(name):
    rng = np.random.default_rng(0)
    for _ in range(20):
        mean = rng.normal(size=30)
        some = Outcomes(mean, mean + rng.random(30), None, rng.integers(0, 9, 30))
        found = curriculum_named(name).weights(some)
        assert found.sum() == pytest.approx(1.0)
        assert (found >= 0.5 / 30 - 1e-12).all()


@pytest.mark.parametrize("name", CURRICULA)
def test_jax_finds_what_numpy_does(name):
    jnp = pytest.importorskip("jax.numpy", reason="the jax extra is not installed")
    jax = pytest.importorskip("jax")
    rng = np.random.default_rng(1)
    some = Outcomes(rng.random(8), 1.0 + rng.random(8), rng.random(8), rng.integers(0, 9, 8))
    rule = curriculum_named(name)
    found = jax.jit(rule.weights)(jax.tree.map(jnp.asarray, some))
    np.testing.assert_allclose(found, rule.weights(some), rtol=1e-5)


def test_constants_that_make_no_sense_are_refused():
    for share in (-0.1, 1.5, float("nan"), "half"):
        with pytest.raises(InvalidInput, match=r"uniform must be a share within \[0, 1\], got"):
            Learnability(uniform=share)
        with pytest.raises(InvalidInput, match=r"staleness must be a share within \[0, 1\], got"):
            Regret(staleness=share)
    for temperature in (0.0, -1.0, float("inf")):
        with pytest.raises(InvalidInput, match="temperature must be finite and > 0"):
            Regret(temperature=temperature)


def test_one_number_per_context_is_taken():
    for wrong in (np.zeros((2, 3)), np.zeros(0), 0.5):
        with pytest.raises(InvalidInput, match="one number per context"):
            learnability(wrong)
        with pytest.raises(InvalidInput, match="one number per context"):
            ranked(wrong, temperature=1.0)


def test_a_mistyped_name_finds_its_neighbour():
    with pytest.raises(UnknownName, match="Did you mean 'regret'"):
        curriculum_named("regrets")
