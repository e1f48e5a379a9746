"""Theory: closed answers, brute force, and the four slips of the printed mathematics."""

import itertools

import numpy as np
import pytest

from mbtl import theory
from mbtl.errors import InvalidInput
from mbtl.objective import regret


def rbf(n: int, length: float) -> np.ndarray:
    x = np.arange(n)
    return np.exp(-0.5 * ((x[:, None] - x) / length) ** 2)


def test_beta_schedules_are_the_paper_formulas():
    assert theory.beta_experiments(5, 100) == pytest.approx(2 * np.log(2500))
    # cmdp-spec 8.2: sqrt(beta) is 3.46, 3.96 and 4.48 at picks 2, 5 and 15 of N = 100
    assert np.sqrt(theory.beta_experiments([2, 5, 15], 100)) == pytest.approx(
        [3.46, 3.96, 4.48], abs=5e-3
    )
    assert theory.beta_theory(1, 6, 0.5) == pytest.approx(2 * np.log(2 * np.pi**2))


@pytest.mark.parametrize("delta", [0.0, 1.0, -0.1, float("nan")])
def test_delta_must_be_a_probability(delta):
    with pytest.raises(InvalidInput, match="delta"):
        theory.beta_theory(1, 10, delta)


def test_picks_count_from_one():
    with pytest.raises(InvalidInput, match="count from 1"):
        theory.beta_experiments([0, 1], 10)


def test_information_of_independent_observations_adds_up():
    # two unrelated contexts of variance 3 and noise 1: 2 * 1/2 log(1 + 3)
    assert theory.information_gain(3 * np.eye(2), noise_std=1.0) == pytest.approx(np.log(4))


def test_information_of_identical_contexts_is_that_of_one_with_less_noise():
    gain = theory.information_gain(np.ones((4, 4)), noise_std=0.5)
    assert gain == pytest.approx(0.5 * np.log(1 + 4 / 0.25))


def test_greedy_gain_equals_the_determinant_of_its_own_set():
    kernel = 0.8 * rbf(30, 3.0)
    found = theory.maximum_information_gain(kernel, 12, noise_std=0.05)
    for k in (1, 4, 12):
        block = kernel[np.ix_(found.sources[:k], found.sources[:k])]
        assert found.greedy[k - 1] == pytest.approx(
            theory.information_gain(block, noise_std=0.05), rel=1e-9
        )


def test_gamma_lies_between_greedy_and_its_upper_bound():
    kernel = rbf(9, 1.5)
    found = theory.maximum_information_gain(kernel, 4, noise_std=0.3)
    for k in range(1, 5):
        gamma = max(
            theory.information_gain(kernel[np.ix_(a, a)], noise_std=0.3)
            for a in itertools.combinations(range(9), k)
        )
        assert found.greedy[k - 1] <= gamma + 1e-12
        assert gamma <= found.upper[k - 1]
    assert found.greedy[0] == pytest.approx(0.5 * np.log(1 + 1 / 0.09))


def test_each_greedy_step_takes_the_most_informative_open_context():
    kernel = rbf(15, 2.0) + np.diag(np.linspace(0, 0.3, 15))
    found = theory.maximum_information_gain(kernel, 5, noise_std=0.1)
    taken: list[int] = []
    for source in found.sources:
        gains = [
            -np.inf
            if x in taken
            else theory.information_gain(kernel[np.ix_([*taken, x], [*taken, x])], noise_std=0.1)
            for x in range(15)
        ]
        assert gains[source] == pytest.approx(max(gains), abs=1e-9)
        taken.append(source)
    assert len(set(found.sources)) == 5


@pytest.mark.parametrize(
    ("kernel", "budget", "noise", "match"),
    [
        (np.ones((2, 3)), 1, 1.0, "square"),
        (np.eye(3), 4, 1.0, "budget"),
        (np.eye(3), 0, 1.0, "budget"),
        (np.eye(3), 1, 0.0, "noise_std"),
    ],
)
def test_information_gain_rejects(kernel, budget, noise, match):
    with pytest.raises(InvalidInput, match=match):
        theory.maximum_information_gain(kernel, budget, noise_std=noise)


def test_regret_bound_is_the_printed_formula():
    beta, gamma = np.array([2.0, 3.0]), np.array([0.5, 0.9])
    c1 = 8 / np.log(1 + 0.1**-2)
    bound = theory.regret_bound(beta, gamma, noise_std=0.1)
    assert bound == pytest.approx(np.sqrt([1 * c1 * 2.0 * 0.5, 2 * c1 * 3.0 * 0.9]))


def test_confidence_constant_scales_with_the_prior_variance():
    # performance in other units: variance and noise variance times 4, regret squared times 4
    wide = theory.confidence_constant(0.2, prior_variance=4.0)
    assert wide == pytest.approx(4 * theory.confidence_constant(0.1))


def test_restricted_bound_with_nothing_eliminated_is_the_plain_bound():
    beta, gamma = theory.beta_theory(np.arange(1, 6), 100, 0.1), np.linspace(1, 2, 5)
    plain = theory.regret_bound(beta, gamma, noise_std=0.01)
    same = theory.restricted_regret_bound(beta, gamma, np.ones(5), noise_std=0.01)
    less = theory.restricted_regret_bound(beta, gamma, theory.sqrt_fractions(5), noise_std=0.01)
    assert same == pytest.approx(plain)
    assert (less[1:] < plain[1:]).all()


def test_restricted_bound_rejects_fractions_that_are_not():
    with pytest.raises(InvalidInput, match=r"\[0, 1\]"):
        theory.restricted_regret_bound([1.0], [1.0], [1.5], noise_std=0.1)
    with pytest.raises(InvalidInput, match="one length"):
        theory.restricted_regret_bound([1.0], [1.0], [1.0, 0.5], noise_std=0.1)


def test_slip_1_the_printed_search_space_subtracts_the_gap_twice():
    best = np.full(9, 0.7)
    gap = 0.0499 * np.abs(np.arange(9) - 4)
    meant = theory.search_space(best, 0.9, gap)
    printed = theory.search_space(best, 0.9, gap, form="printed")
    assert meant.all()  # the ends still count: 0.9 - 0.0499 * 4 > 0.7
    assert np.flatnonzero(printed).tolist() == [2, 3, 4, 5, 6]


def test_slip_3_the_harmonic_sum_exceeds_log_k_always():
    sums = theory.squared_sum(theory.sqrt_fractions(1000))
    assert sums[3] == pytest.approx(1 + 1 / 2 + 1 / 3 + 1 / 4)
    assert (sums > theory.sqrt_sum_bound(1000, form="printed")).all()
    assert (sums <= theory.sqrt_sum_bound(1000) + 1e-12).all()


def test_slip_4_the_halving_sum_passes_pi_squared_over_six_at_the_sixth_training():
    sums = theory.squared_sum(theory.halving_fractions(4096))
    printed = theory.halving_sum_bound(4096, form="printed")
    assert sums[4:6] == pytest.approx([1.625, 1.6875])
    assert (sums <= printed)[:5].all()
    assert (sums > printed)[5:].all()
    assert (sums < theory.halving_sum_bound(4096)).all()
    assert sums[-1] == pytest.approx(2.0, abs=1e-3)


def test_halving_fractions_change_exactly_at_powers_of_two():
    assert theory.halving_fractions(8) == pytest.approx([1, 0.5, 0.5] + [0.25] * 4 + [0.125])


@pytest.mark.parametrize(
    ("mask", "length"),
    [([], 0), ([0, 0], 0), ([1, 1, 0, 1], 2), ([0, 1, 0, 1, 1, 1], 3), ([1, 1], 2)],
)
def test_longest_run(mask, length):
    assert theory.longest_run(np.array(mask, dtype=bool)) == length


def test_elimination_in_a_linear_gap_world_by_hand():
    # N = 11, slope 0.1, constant training performance: after the middle (5), the policy of 0 is
    # at least as good where |x' - 0| <= |x' - 5|, that is on 0, 1, 2.
    i = np.arange(11)
    matrix = 1.0 - 0.1 * np.abs(i[:, None] - i)
    rates = theory.elimination_rate(matrix, [5, 0], theta=0.1)
    assert rates == pytest.approx([1.0, 3 / 11])
    printed = theory.elimination_rate(matrix, [5, 0], theta=0.1, form="printed")
    assert printed == pytest.approx([1.0, 2 / 11])  # 0.5 <= 1, 0.6 <= 0.8, not 0.7 <= 0.6
    hopeful = theory.elimination_rate(matrix, [5, 0], theta=0.1, predicted=[1.0, 1.2])
    assert hopeful[1] == 4 / 11  # 1.2 - 0.1 x' >= 0.5 + 0.1 x' up to 3


def test_elimination_rejects_what_is_not_there():
    with pytest.raises(InvalidInput, match="from 0 to 2"):
        theory.elimination_rate(np.eye(3), [3], theta=0.1)
    with pytest.raises(InvalidInput, match=r"\(N, N\)"):
        theory.elimination_rate(np.ones((2, 3)), [0], theta=0.1)
    with pytest.raises(InvalidInput, match="form"):
        theory.search_space(np.zeros(2), 1.0, np.zeros(2), form="meant")


def test_regret_is_the_loss_against_the_best_pick_of_the_same_history():
    matrix = np.array([[0.9, 0.1, 0.0], [0.2, 0.6, 0.5], [0.0, 0.3, 0.8]])
    # first: row means 1/3, 1.3/3, 1.1/3, so picking 0 loses 0.3/3; then the best of the rest
    # raises V from (0.9, 0.1, 0.0) to (0.9, 0.6, 0.5) by 1, while source 2 also gives 1.0
    assert regret(matrix, [0, 1]) == pytest.approx([0.1, 0.0])
    assert regret(matrix, [0, 0])[1] == pytest.approx(1.0 / 3)
