"""The lead of one selector over another: paired, with an interval per question."""

import numpy as np
import pytest
import scipy.stats

from mbtl.errors import UnknownName
from mbtl.zoo.benchmark.base import Levels
from mbtl.zoo.benchmark.comparison import Comparison, Estimate, Trainings, summarise
from mbtl.zoo.benchmark.oracle import OracleRun, Reference

K = 2


def compared(*matrices):
    """Curves by selector on matrices of V_random = 0.2 and V_oracle = 0.8, and their summary."""
    curves = {f"m{i}": {n: np.asarray(v) for n, v in by.items()} for i, by in enumerate(matrices)}
    known = Reference(
        levels=Levels(independent=0.7, oracle_transfer=0.9, grand_mean=0.1),
        random=np.full(K, 0.2),
        oracle=OracleRun(sources=(0,) * K, curve=np.full(K, 0.8), seconds=0.0),
        rows={},
    )
    references = {name: [known] * len(next(iter(by.values()))) for name, by in curves.items()}
    return Comparison((), summarise(curves, references), curves, references)


def pair(base, lead):
    base = np.asarray(base)[:, None] * np.ones(K)
    return {"a": base + np.asarray(lead)[:, None], "b": base}


def test_what_is_hard_for_both_cancels():
    result = compared(pair([0.3, 0.5, 0.7], [0.06, 0.06, 0.06]))
    alone = result.summary.pooled["a"].V_mean
    found = result.difference("a", "b").matrices["m0"]
    assert alone.high - alone.low > 0.2
    assert found.V_K.value == pytest.approx(0.06)
    assert (found.V_K.low, found.V_K.high) == pytest.approx((0.06, 0.06))
    assert found.closed_under_curve.value == pytest.approx(0.06 / 0.6)  # of the room, 0.8 - 0.2
    assert found.per_seed == pytest.approx((0.06, 0.06, 0.06))
    assert found.ahead == 3


def test_a_lead_is_the_other_ones_lag_and_the_difference_of_the_tables_numbers():
    result = compared(pair([0.3, 0.5, 0.7], [0.1, -0.2, 0.02]))
    one, other = result.difference("a", "b").pooled, result.difference("b", "a").pooled
    table = result.summary.pooled
    assert one.V_mean.value == pytest.approx(table["a"].V_mean.value - table["b"].V_mean.value)
    assert one.closed_at_K.value == pytest.approx(
        table["a"].closed_at_K.value - table["b"].closed_at_K.value
    )
    assert one.V_mean.low == pytest.approx(-other.V_mean.high)
    assert (one.ahead, other.ahead) == (2, 1)


def test_over_matrices_the_interval_knows_that_problems_differ():
    seeds = [0.3, 0.31, 0.3]
    result = compared(*(pair(seeds, [lead] * 3) for lead in (0.2, 0.0, 0.1, -0.1)))
    found = result.difference("a", "b")
    assert found.pooled.V_mean.value == found.over_matrices.V_mean.value == pytest.approx(0.05)
    assert found.pooled.V_mean.high - found.pooled.V_mean.low < 1e-9  # these problems, other seeds
    interval = found.over_matrices.V_mean
    assert interval.low < 0.0 < interval.high
    wide = scipy.stats.t.ppf(0.975, 3) * np.std([0.2, 0.0, 0.1, -0.1], ddof=1) / 2.0
    assert (interval.high - interval.low) / 2.0 == pytest.approx(wide, rel=0.1)
    assert repr(found).count(" of 3") == 4  # no column is cut
    assert "6 of 12" in repr(found)
    assert "…" not in repr(found)
    two = compared(*(pair(seeds, [lead] * 3) for lead in (0.2, 0.0)))
    assert two.difference("a", "b").over_matrices.V_mean.low is None


def test_one_that_was_not_compared_is_refused():
    with pytest.raises(UnknownName, match="'c'"):
        compared(pair([0.3], [0.1])).difference("a", "c")


def test_numbers_of_a_summary_are_short_to_read():
    assert repr(Estimate(0.5, None, None)) == "0.5"
    assert repr(Estimate(11.000000000000002, 9.0, 13.2)) == "11 [9, 13.2]"
    reached = Trainings(Estimate(11.000000000000002, 9.0, 13.2), 0, (9, 11, 13))
    assert repr(reached) == "11 [9, 13.2] (by seed: 9, 11, 13)"
    late = Trainings(Estimate(12.1, 9.0, 16.0), 1, (9, 12, None))
    assert repr(late) == ">12.1 (1 of 3 seeds did not get there; by seed: 9, 12, never)"
    never = Trainings(Estimate(None, None, None), 1, (None,))
    assert repr(never) == "(1 of 1 seeds did not get there; by seed: never)"


def test_bench_shows_and_writes_the_difference_that_was_asked_for(mbtl_command, monkeypatch):
    np.savez("mine.npz", returns=np.random.default_rng(0).normal(size=(2, 10, 10)))
    asked = ("bench", "--matrix", "mine.npz", "--selectors", "greedy", "--budget", 4)
    monkeypatch.setenv("COLUMNS", "120")
    shown = mbtl_command.done(*asked, "--against", "mbtl")
    assert "less mbtl, on the same seeds" in shown
    assert "of 2" in shown
    (found,) = mbtl_command.document(*asked, "--against", "mbtl")["differences"]
    assert (found["selector"], found["against"]) == ("greedy", "mbtl")
    assert "differences" not in mbtl_command.document(*asked)
