from dataclasses import replace

import numpy as np
import pytest

import mbtl
from mbtl.history import History
from mbtl.models import priors
from mbtl.models.transfer_kernel import TransferPrior
from mbtl.selectors import Random, SelectionProblem, Specialists
from mbtl.selectors.specialists import _search, pending_pairs
from mbtl.zoo.benchmark.compare import held_out

RNG = np.random.default_rng(0)


def line(n, budget=10):
    return SelectionProblem.of(
        mbtl.ContextSpace.grid({mbtl.Linear("x", 0.1, 10.0): n}), budget=budget
    )


def reach(n, source, below, above):
    """0.9 on targets from `below` steps under the source to `above` steps over it, else 0.1."""
    away = np.arange(n) - source
    return np.where((away >= -below) & (away <= above), 0.9, 0.1)


def test_second_pick_serves_what_the_first_does_not():
    problem = line(100)
    history = History(100).with_row(49, reach(100, 49, 60, 10))
    proposal = Specialists().propose(problem, history, RNG)
    assert 60 < proposal.source < 100
    assert proposal.reason == "largest expected gain"
    assert 0.0 < proposal.acquisition < 0.5


def test_a_pending_pick_counts_as_trained():
    problem = line(100)
    history = History(100).with_row(49, reach(100, 49, 20, 20))
    first = Specialists().propose(problem, history, RNG).source
    second = Specialists().propose(problem, history.with_pending(first), RNG).source
    assert (first - 49) * (second - 49) < 0  # the other side


def test_gaps_in_rows_are_left_out():
    problem, row = line(30), reach(30, 14, 8, 3).astype(float)
    row[::2] = np.nan
    assert Specialists().propose(problem, History(30).with_row(14, row), RNG).source != 14
    nothing = History(30).with_row(14, np.full(30, np.nan))
    assert Specialists().propose(problem, nothing, RNG).source != 14


def test_many_contexts_are_sampled():
    grid = {mbtl.Linear(f"x{q}", 0.0, 1.0): 15 for q in range(3)}
    problem = SelectionProblem.of(mbtl.ContextSpace.grid(grid), budget=5)
    history, few = History(problem.n), Specialists(most_candidates=40, most_targets=30)
    for _ in range(4):
        source = few.propose(problem, history, RNG).source
        away = np.abs(problem.unit - problem.unit[source]).sum(axis=1)
        history = history.with_row(source, 1.0 - away)
    assert len(set(history.sources)) == 4
    rows = 1.0 - np.abs(problem.unit[:, None] - problem.unit[None, ::7]).sum(axis=2)
    random = [rows[RNG.permutation(problem.n)[:4]].max(axis=0).mean() for _ in range(200)]
    assert history.best[::7].mean() > np.quantile(random, 0.6)


def test_benchmarks_use_the_prior_that_has_not_seen_the_family(monkeypatch):
    unseen = TransferPrior(target=7.0)
    monkeypatch.setattr(priors, "PRIORS", {"all": TransferPrior(), "cartpole": unseen})
    assert held_out(Specialists(), "cartpole-length-hidden").prior == unseen
    assert held_out(Specialists(), "ring-acc").prior == TransferPrior()
    assert held_out(Random(), "cartpole-length") == Random()
    own = Specialists(prior=TransferPrior(luck=3.0))  # learned from nothing of ours
    assert held_out(own, "cartpole-length") == own


def test_gain_per_cost_prefers_the_cheap_of_two_alike():
    n = 41
    problem = line(n)
    history = History(n).with_row(20, reach(n, 20, 6, 6))
    free = Specialists().propose(problem, history, RNG).source
    costs = np.where((np.arange(n) < 20) == (free < 20), 10.0, 1.0)
    proposal = Specialists().propose(replace(problem, costs=costs), history, RNG)
    assert (proposal.source < 20) != (free < 20)
    assert proposal.reason.endswith("per cost")


def test_with_a_risk_only_the_worst_targets_count():
    row = np.where(np.arange(40) < 20, 0.5, 0.6)
    row[:4] = 0.0
    wish, history = replace(line(40), risk=0.1), History(40).with_row(25, row)
    assert Specialists().propose(wish, history, RNG).source < 8


def test_chance_of_a_gain_falls_with_what_is_asked():
    problem, chances = line(50), []
    history = History(50).with_row(24, reach(50, 24, 10, 10))
    for least in (0.05, 0.25, 0.9):
        wish = replace(problem, least_left=least)
        chances.append(Specialists().propose(wish, history, RNG).chance_left)
    assert chances[0] > chances[1] > chances[2] == 0.0
    assert Specialists().propose(problem, history, RNG).chance_left is None


def test_noise_told_is_not_taken_for_a_gain():
    """One policy is as good as can be; noisy entries below it must not send picks after them."""
    n, rng = 40, np.random.default_rng(5)
    exact = History(n).with_row(19, np.full(n, 0.8)).with_row(9, np.full(n, 0.8))
    noisy = exact.rows + 0.2 * rng.standard_normal(exact.rows.shape)
    told = History(n, exact.sources, noisy, errors=np.full(noisy.shape, 0.2))
    untold = History(n, exact.sources, noisy)
    gain = [Specialists().propose(line(n), h, RNG).acquisition for h in (told, untold)]
    assert gain[0] < 0.7 * gain[1]


def test_a_catastrophe_does_not_hide_the_rest():
    """Far outside all, and below the bounds by their whole width: how far is all the same."""
    n, picks = 40, []
    for worst in (-1e2, -1e6):
        row = reach(n, 19, 8, 8)
        row[30:33] = worst
        picks.append(Specialists().propose(line(n), History(n).with_row(19, row), RNG))
    assert picks[0] == picks[1]


def test_with_many_contexts_the_error_of_the_gain_is_stated():
    axes = {mbtl.Linear(name, 0.0, 1.0): 20 for name in "ab"}
    problem = SelectionProblem.of(mbtl.ContextSpace.grid(axes), budget=10)
    away = np.abs(problem.unit - problem.unit[210]).sum(axis=1)
    history = History(400).with_row(210, 1.0 - away)
    proposal = Specialists().propose(problem, history, RNG)
    assert "judged on 150 of 400 targets" in proposal.notes[0]
    stated = float(proposal.notes[0].split("+- ")[1].split(",")[0])
    whole = Specialists(final_targets=400).propose(problem, history, RNG)
    assert whole.notes == ()
    assert abs(whole.acquisition - proposal.acquisition) < 4 * stated


def test_little_is_said_to_be_left_where_hard_targets_are_served_as_well_as_they_can_be():
    n, history = 50, History(50)
    ceiling = np.linspace(1.0, 0.3, n)  # what a training on the target itself gives
    for source in (4, 14, 24, 34, 44):
        far = np.abs(np.arange(n) - source) > 5
        history = history.with_row(source, ceiling - 0.2 * far)
    proposal = Specialists().propose(line(n), history, RNG)
    assert proposal.acquisition < 0.015  # 0.05 without ceilings


def hills():
    """Spaces on which the search is tried: fine and coarse axes, categories, hardly too many."""
    fine, coarse = mbtl.Linear("fine", 0.0, 1.0), [mbtl.Linear(name, 0.0, 1.0) for name in "abc"]
    kinds = [mbtl.Categorical(name, tuple("pqrs")) for name in "de"]
    grid = mbtl.ContextSpace.grid
    yield grid(dict.fromkeys(coarse, 20))
    yield grid({fine: 100, **dict.fromkeys(kinds, 4)})
    yield grid({fine: 5000})


@pytest.mark.parametrize("space", list(hills()), ids=repr)
def test_the_search_for_a_source_ends_at_the_top_of_a_hill(space):
    problem = SelectionProblem.of(space, budget=5)
    everyone = np.arange(problem.n)
    for seed in range(3):
        top, asked = np.random.default_rng(seed).random(problem.unit.shape[1]), []
        height = -np.square(problem.unit - top).sum(axis=1)

        def gain_of(sources, height=height, asked=asked):
            asked.extend(sources)
            return height[sources]

        found, gain = _search(problem, everyone, 100, np.ones(problem.n), (), gain_of)
        assert gain.max() == height.max()
        assert len(asked) == len(set(asked)) == len(found) < 600
        np.testing.assert_array_equal(gain, height[found])
    few, _ = _search(problem, everyone[:60], 100, np.ones(problem.n), (), gain_of)
    np.testing.assert_array_equal(few, everyone[:60])


def test_many_picks_under_way_are_stood_for_by_a_limited_number_of_pairs():
    """A hundred picks on fifty targets each were 5,000 pairs, and n^3 of that for each proposal."""
    problem = line(400)
    targets = np.arange(0, 400, 8)
    told = History(400, (1, 2, 5, 6, 7), np.zeros((5, 400)))
    every = pending_pairs(problem, replace(told, pending=(3, 200)), targets)
    assert len(every) == 100
    assert set(every[:, 2]) == {5, 6}
    waiting = tuple(range(0, 400, 4))
    many = pending_pairs(problem, replace(told, pending=waiting), targets)
    assert len(many) < 500
    assert set(many[:, 2]) == set(range(5, 105))
    for source, target, number in many:
        assert source == 4 * (number - 5)
        assert number < 15 or abs(target - source) <= 40
    np.testing.assert_array_equal(
        pending_pairs(problem, replace(told, pending=waiting[:50]), targets), many[many[:, 2] < 55]
    )


def straight(steps, source, *, quality=0.0, fall=0.03, scatter=0.02):
    """A row of a world of straight lines, the same for a source every time."""
    noise = scatter * np.random.default_rng(source).standard_normal(len(steps))
    away = np.abs(steps - steps[source]).sum(axis=1)
    return 0.6 + quality * steps[source].sum() - fall * away + noise


def after(problem, sources, **world):
    history = History(problem.n)
    for source in sources:
        history = history.with_row(source, straight(problem.steps, source, **world))
    return history


def cube():
    grid = {mbtl.Linear(f"x{q}", 0.0, 1.0): 5 for q in range(3)}
    return SelectionProblem.of(mbtl.ContextSpace.grid(grid), budget=20)


def test_straight_lines_lead_to_the_best_source_far_from_all_tried():
    """Sources are better the farther up on every axis, and better than transfer costs."""
    problem = cube()
    history = after(problem, [62, 31, 38, 93, 85], quality=0.05, fall=0.01)
    proposal = Specialists().propose(problem, history, RNG)
    assert proposal.reason == "largest expected gain by straight lines"
    assert tuple(problem.steps[proposal.source]) == (4.0, 4.0, 4.0)
    outlook = Specialists().outlook(problem, history, np.arange(problem.n))
    assert outlook.mean == pytest.approx(0.6 + 0.05 * problem.steps.sum(axis=1), abs=0.08)
    assert outlook.gain.argmax() == proposal.source
    early = Specialists().propose(problem, after(problem, [62, 31]), RNG)
    assert early.reason == "largest expected gain"  # not before every slope is known


def test_where_distance_is_all_straight_lines_space_better_than_chance():
    problem = cube()
    history = after(problem, [62])
    while len(history) < 12:
        source = Specialists().propose(problem, history, RNG).source
        history = history.with_row(source, straight(problem.steps, source))
    away = np.abs(problem.steps[:, None] - problem.steps).sum(axis=2)
    orders = [RNG.permutation(problem.n)[:12] for _ in range(200)]
    chance = [away[order].min(axis=0).mean() for order in orders]
    assert away[list(history.sources)].min(axis=0).mean() < np.quantile(chance, 0.1)


def test_straight_lines_count_pending_picks_and_gaps_in_rows():
    problem = cube()
    history = after(problem, [62, 31, 38, 93, 85])
    first = Specialists().propose(problem, history, RNG)
    assert first.reason.endswith("by straight lines")
    second = Specialists().propose(problem, history.with_pending(first.source), RNG)
    assert np.abs(problem.steps[first.source] - problem.steps[second.source]).sum() > 2
    rows = history.rows.copy()
    rows[:, ::3] = np.nan
    partial = Specialists().propose(problem, replace(history, rows=rows), RNG)
    assert partial.reason.endswith("by straight lines")
    assert np.isfinite(partial.acquisition)
