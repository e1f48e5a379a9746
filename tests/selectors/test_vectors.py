"""Test vectors of the specification and closed answers of a linear-gap world."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn_gp import fit_sklearn

from mbtl import selectors
from mbtl.acquisition import optimistic_gain
from mbtl.contexts import Categorical, ContextSpace, Linear
from mbtl.errors import InvalidInput, UnknownName
from mbtl.history import History
from mbtl.models import GPSettings, fit_gp
from mbtl.objective import value_curve
from mbtl.selectors import GPMBTL, MBTL, MBTLRelease, SelectionProblem, get_selector, model_based
from mbtl.selectors.base import served
from mbtl.selectors.mbtl import ucb_weight

GREEDY = {
    100: [49, 82, 16, 32, 65, 40, 73, 93, 5, 24, 57, 10, 87, 44, 77],
    50: [24, 41, 8, 32, 16, 36, 3, 12, 20, 28, 46, 5, 38, 43, 10],
    40: [19, 32, 6, 12, 25, 15, 28, 37, 2, 9, 22, 34, 4, 17, 30],
}
EQUIDISTANT = [96, 89, 82, 76, 69, 63, 56, 49, 43, 36, 30, 23, 16, 10, 3]


def line(n):
    return ContextSpace.grid({Linear("x", 0.0, n - 1.0): n})


def linear_world(n=100, theta=0.005):
    i = np.arange(n)
    return 0.9 - theta * np.abs(i[:, None] - i)


def play(selector, matrix, budget, space=None, theta=None):
    """Sources and V after each, of a selector on a known matrix."""
    n = len(matrix)
    problem = SelectionProblem.of(space or line(n), budget=budget, theta=theta)
    history = History(n)
    for k in range(budget):
        proposal = get_selector(selector).propose(problem, history, np.random.default_rng(k))
        history = history.with_row(proposal.source, matrix[proposal.source])
    return list(history.sources), value_curve(history.rows)


@pytest.mark.parametrize("n", GREEDY)
def test_greedy_splits_gaps_as_specified(n):
    sources, curve = play("greedy", linear_world(n), 15)
    assert sources == GREEDY[n]
    if n == 100:
        assert curve[[3, 14]] == pytest.approx([0.86515, 0.8909], abs=5e-5)


def test_equidistant_takes_cell_midpoints_from_the_top_down():
    sources, curve = play("equidistant", linear_world(), 15)
    assert sources == EQUIDISTANT
    assert curve[14] == pytest.approx(0.89175, abs=5e-6)
    assert play("equidistant", linear_world(10), 10)[0] == list(range(9, -1, -1))


@pytest.mark.parametrize("selector", ["mbtl", "mbtl-ei", "worst-first"])
def test_mbtl_starts_in_the_middle_and_warms_up_where_it_is_worst(selector):
    sources, curve = play(selector, linear_world(), 4)
    assert sources == [49, 99, 0, 74]
    assert curve[3] == pytest.approx(0.8544, abs=5e-5)


@pytest.mark.parametrize("selector", ["mbtl", "gp-mbtl", "worst-first"])
def test_a_target_that_nobody_was_evaluated_on_counts_as_the_transfer_model_believes(selector):
    row = np.full(10, np.nan)
    row[[0, 4, 7]] = 0.9, 0.5, 0.1
    history, problem = History(10).with_row(4, row), SelectionProblem.of(line(10), budget=5)
    best = served(problem, history)
    np.testing.assert_array_equal(best[[0, 4, 7]], [0.9, 0.5, 0.1])
    truth = np.interp(np.arange(10), [0, 4, 7], [0.9, 0.5, 0.1])
    nearest = np.array([0.9] * 3 + [0.5] * 3 + [0.1] * 4)
    assert np.abs(best - truth)[:8].mean() < 0.6 * np.abs(nearest - truth)[:8].mean()
    pick = get_selector(selector).propose(problem, history, np.random.default_rng(0))
    assert pick.source >= 5  # where it is worst, and not 1, the first without an entry
    whole = History(10).with_row(4, truth)
    assert served(problem, whole) is whole.best


@pytest.mark.parametrize(("n", "first"), [(100, 49), (50, 24), (40, 19)])
@pytest.mark.parametrize("selector", ["mbtl", "mbtl-release", "mbtl-ei", "greedy", "worst-first"])
def test_first_pick_is_the_lower_middle(selector, n, first):
    assert play(selector, linear_world(n), 1)[0] == [first]
    if selector != "greedy":
        space = ContextSpace.grid({Linear("a", 0, 1): 5, Linear("b", 0, 1): 7})
        (source,), _ = play(selector, np.zeros((35, 35)), 1, space)
        assert space.context(source) == {"a": 0.5, "b": 0.5}


@pytest.mark.parametrize("selector", [MBTL, MBTLRelease])
def test_the_fast_gp_gives_the_picks_of_the_papers_gp(selector):
    rng = np.random.default_rng(3)
    matrix = linear_world() - 0.1 * np.abs(np.sin(np.arange(100) / 9.0))[:, None]
    matrix = matrix + 0.02 * rng.standard_normal(matrix.shape)
    sources = play(selector(), matrix, 8)[0]
    problem, rng = SelectionProblem.of(line(100), budget=8), np.random.default_rng(0)
    # the likelihood of a single observation does not depend on the length-scale: start from two
    for k in (2, 4, 7):
        history = History(100, tuple(sources[:k]), matrix[sources[:k]])
        assert selector(fitter=fit_sklearn).propose(problem, history, rng).source == sources[k]


def test_release_trains_its_gp_on_the_running_best():
    rows = np.array([[0.5, 0.6, 0.1], [0.2, 0.4, 0.3], [0.0, 0.0, 0.9]])
    history = History(3, (0, 1, 2), rows)
    assert MBTLRelease()._observed(history) == pytest.approx([0.5, 0.6, 0.9])


def test_release_counts_negative_performance_as_zero():
    matrix = linear_world(20, 0.005) - 2.0
    problem = SelectionProblem.of(line(20), budget=5)
    history = History(20).with_row(9, matrix[9])
    proposal = MBTLRelease().propose(problem, history, np.random.default_rng(0))
    gp = fit_gp(np.array([[9.0]]), matrix[[9], 9], GPSettings(0.1))
    mean, std = gp.predict(problem.steps)
    upper, where = mean + np.sqrt(np.log(2)) * std, problem.steps
    gain = optimistic_gain(upper, where, where, np.zeros(20), problem.weights, theta=0.005)
    assert proposal.acquisition == pytest.approx(gain[proposal.source])


def test_zero_acquisition_falls_back_to_the_most_uncertain_context():
    problem, history = SelectionProblem.of(line(11), budget=11, theta=100.0), History(11)
    own = {0: 0.1, 5: 0.4, 10: 0.05, 2: 0.3}
    for source, performance in own.items():  # each serves all others perfectly and itself badly
        history = history.with_row(source, np.where(np.arange(11) == source, performance, 50.0))
    proposal = MBTL().propose(problem, history, np.random.default_rng(0))
    std = fit_gp(list(own), list(own.values())).predict(problem.steps)[1]
    std[list(own)] = -1.0
    assert proposal.acquisition == 0.0
    assert "most uncertain" in proposal.reason
    assert proposal.source == std.argmax()


def test_categorical_contexts_are_trained_one_per_level():
    space = ContextSpace.grid({Categorical("road", ("dry", "wet", "ice")): 3})
    assert sorted(play("mbtl", 0.4 + 0.6 * np.eye(3), 3, space)[0]) == [0, 1, 2]


@pytest.mark.parametrize("selector", ["greedy", "equidistant"])
def test_one_dimensional_selectors_say_so(selector):
    space = ContextSpace.grid({Linear("a", 0, 1): 3, Linear("b", 0, 1): 3})
    with pytest.raises(InvalidInput, match="one numeric axis, got a, b"):
        play(selector, np.eye(9), 2, space)


@pytest.mark.parametrize("selector", [MBTL, GPMBTL])
def test_a_broken_fit_falls_back_and_says_so(selector):
    def broken(points, y, settings):
        raise np.linalg.LinAlgError("no convergence")

    problem = SelectionProblem.of(line(20), budget=10)
    history = History(20)
    for source in (9, 0, 19, 4):
        history = history.with_row(source, linear_world(20)[source])
    proposal = selector(fitter=broken).propose(problem, history, np.random.default_rng(0))
    assert "no convergence" in proposal.notes[0]
    assert proposal.source not in history.sources


def test_random_is_uniform():
    problem, history = SelectionProblem.of(line(4), budget=4), History(4)
    draws = [
        get_selector("random").propose(problem, history, np.random.default_rng(s)).source
        for s in range(800)
    ]
    counts = np.bincount(draws, minlength=4)
    assert np.abs(counts - 200).max() < 5 * np.sqrt(200 * 0.75)


def test_unknown_selector_gets_a_suggestion():
    with pytest.raises(UnknownName, match="Did you mean 'mbtl-ei'"):
        get_selector("mbtl-ie")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: SelectionProblem.of(line(10), budget=0), r"number of contexts \(10\), got 0"),
        (lambda: SelectionProblem.of(line(10), budget=11), r"number of contexts \(10\), got 11"),
        (lambda: MBTL(acquisition="guessed"), "acquisition"),
        (lambda: MBTL(warm_up=-1), "warm_up"),
        (lambda: selectors.SDMBTL(look_after=1), "look_after"),
    ],
)
def test_what_fits_no_selection_is_refused(make, words):
    with pytest.raises(InvalidInput, match=words):
        make()


def test_warm_up_goes_on_when_nothing_is_known_of_own_performance():
    row = np.linspace(0.2, 0.8, 12)
    row[5] = np.nan  # the source itself was not evaluated
    history = History(12).with_row(5, row).with_pending(0)
    proposal = MBTL().propose(SelectionProblem.of(line(12), budget=5), history, None)
    assert proposal.source == 1


@pytest.mark.parametrize("name", ["gp-mbtl", "mbtl-ei", "mbtl", "mbtl-release"])
@pytest.mark.parametrize("axes", [1, 2])
def test_a_part_of_very_many_contexts_stands_for_all_and_the_pick_says_so(monkeypatch, name, axes):
    each = {1: 400, 2: 20}[axes]
    space = ContextSpace.grid({Linear(f"x{q}", 0.0, 1.0): each for q in range(axes)})
    problem = SelectionProblem.of(space, budget=9, theta=0.5 / each)
    history, unit, proposals = History(space.n), space.unit, []
    for source in (20, 210, 390, 5, 111, 333):
        away = np.linalg.norm(unit - unit[source], axis=1)
        history = history.with_row(source, 0.9 - 0.5 * away - 0.2 * abs(unit[source, 0] - 0.4))
    for most, open_ones in ((400, range(400)), (100, range(400)), (400, ())):
        monkeypatch.setattr(model_based, "MOST", most)
        closed = set(range(400)) - {*history.sources, *(open_ones or [proposals[1].source])}
        past = replace(history, failed=tuple(closed))
        proposals.append(get_selector(name).propose(problem, past, np.random.default_rng(0)))
    whole, thin, there = proposals  # the last is the gain of the second, of all targets
    said = ("100 candidates and 100 targets stood for 400 contexts",)
    assert (whole.notes, thin.notes) == ((), said)
    assert thin.source == there.source
    assert there.acquisition >= 0.9 * whole.acquisition


def test_the_exploration_weight_is_that_of_the_paper():
    # cmdp-spec 8.2: sqrt(beta) is 3.46, 3.96 and 4.48 at picks 2, 5 and 15 of N = 100
    found = [ucb_weight(k, 100) ** 0.5 for k in (2, 5, 15)]
    assert found == pytest.approx([3.46, 3.96, 4.48], abs=5e-3)
