import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mbtl.acquisition import line_gain, linear_gap_gain, optimistic_gain


@pytest.mark.parametrize(("m", "n"), [(1, 1), (2, 5), (40, 31), (33, 64), (300, 257), (1000, 1000)])
@pytest.mark.parametrize("kind", ["grid", "ties", "real"])
def test_line_gain_equals_the_direct_formula(m, n, kind):
    rng = np.random.default_rng(m * 1000 + n)
    x, t = rng.uniform(0, n, (m, 1)), rng.uniform(0, n, (n, 1))
    if kind == "grid":
        x, t = rng.permutation(m)[:, None].astype(float), rng.permutation(n)[:, None].astype(float)
    elif kind == "ties":
        x, t = np.round(x / 5), np.round(t / 5)
    upper, best, weights = rng.normal(size=m), rng.normal(size=n), rng.dirichlet(np.ones(n))
    direct = optimistic_gain(upper, x, t, best, weights, theta=0.01)
    assert line_gain(upper, x, t, best, weights, theta=0.01) == pytest.approx(direct, abs=1e-12)


@pytest.fixture
def tiny_leaves():
    """Leaves of a few candidates, so that small cases go through every step."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mbtl.acquisition.line._LEAF", 3)
        yield


@pytest.mark.usefixtures("tiny_leaves")
@settings(
    max_examples=300,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(
    st.integers(1, 80),
    st.sampled_from([0.0, 0.005, 0.3]),
    st.sampled_from([0.0, 0.1]),
    st.integers(0, 999),
)
def test_line_gain_equals_the_direct_formula_with_equal_values(n, theta, grain, seed):
    """Values on a coarse lattice, so that p = q and equal places happen all the time."""
    rng = np.random.default_rng(seed)
    where = rng.integers(0, max(n // 2, 1), (n, 1)).astype(float)
    upper, best = rng.integers(0, 4, n) * (grain or 0.5), rng.integers(0, 4, n) * (grain or 0.5)
    weights = np.full(n, 1 / n)
    direct = optimistic_gain(upper, where, where, best, weights, theta=theta)
    assert line_gain(upper, where, where, best, weights, theta=theta) == pytest.approx(
        direct, abs=1e-13
    )


def test_memory_grows_linearly():
    peaks = []
    for n in (4000, 16000):
        rng = np.random.default_rng(0)
        where = np.arange(n, dtype=float)[:, None]
        arguments = (rng.normal(size=n), where, where, rng.normal(size=n), np.full(n, 1 / n))
        tracemalloc.start()
        line_gain(*arguments, theta=0.5 / n)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 5.5 * peaks[0]


@pytest.mark.parametrize("n", [100, 900])
def test_the_faster_method_is_chosen_without_changing_the_result(n):
    rng = np.random.default_rng(n)
    where = np.arange(n, dtype=float)[:, None]
    arguments = (rng.normal(size=n), where, where, rng.normal(size=n), np.full(n, 1 / n))
    direct = optimistic_gain(*arguments, theta=0.01)
    assert linear_gap_gain(*arguments, theta=0.01) == pytest.approx(direct, abs=1e-12)
