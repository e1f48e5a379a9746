"""Which numbers a study takes, and what crashes cost: an episode, or few trainings of a region."""

import re

import numpy as np
import pytest
from line_problem import line, train

import mbtl
from flat import created, told
from mbtl.episodes import episode_moments
from mbtl.errors import InvalidInput, TrainingFailed
from mbtl.history import History
from mbtl.plain import LARGEST
from mbtl.selectors import get_selector, selector_names
from mbtl.selectors.base import SelectionProblem, success_chance
from mbtl.trainers import FunctionTrainer

N = 5
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0, "m"): N})
ROW = np.linspace(0.0, 1.0, N)


def replaced(row, place, number):
    changed = row.copy()
    changed[place] = number
    return changed


@pytest.mark.parametrize("number", [9e154, -1e300, 1.1e30, np.inf])
def test_a_return_beyond_reach_is_named_with_its_context_and_leaves_the_study_whole(number):
    study = created(SPACE, budget=3, bounds=(0, 1))
    pick = study.ask()
    episodes = replaced(np.tile(ROW[:, None], (1, 3)), (2, 1), number)
    words = f"got {number!r} for x = 0.5 m, the first of 1 of 15; give an episode"
    with pytest.raises(TrainingFailed, match=re.escape(words)):
        study.tell(pick, episodes)
    study.tell(pick, ROW)
    assert study.value == pytest.approx(0.5)
    assert study.ask().source != pick.source


@pytest.mark.parametrize("selector", selector_names())
@pytest.mark.parametrize("bounds", [None, (0.0, 1.0 / LARGEST)])
def test_whatever_passes_the_door_can_be_computed_with(selector, bounds):
    rng = np.random.default_rng(0)
    study = created(SPACE, budget=5, bounds=bounds, strategy=selector)
    for returns in (
        replaced(np.tile(ROW[:, None], (1, 3)), 1, LARGEST),
        np.full((N, 3), LARGEST),
        rng.choice([-LARGEST, LARGEST], (N, 3)),
        LARGEST * rng.uniform(-1, 1, N),
        1e-300 * rng.random((N, 3)),
    ):
        study.tell(study.ask(), returns)
        found = study.routing.value
        assert np.isfinite([study.value, found.error, found.margin, *study.curve]).all()


def test_constant_returns_of_any_size_have_a_scale():
    for size in (0.0, 1e17, -1e30):
        study = mbtl.create_study(SPACE, budget=1)
        study.tell(study.ask(), np.full(N, size))
        assert study.value == 0.0


def test_what_a_mask_hides_is_missing():
    hidden = np.ma.array(np.tile(ROW[:, None], (1, 2)), mask=False)
    hidden[3, 1] = np.ma.masked
    study = created(SPACE, budget=1, bounds=(0, 1))
    told = ((hidden, ROW[3]), (list(hidden), ROW[3]), (hidden[:, 1], np.nan))
    for source, (returns, found) in enumerate(told):
        study.tell(source, returns)
        expected = ROW.copy()
        expected[3] = found  # of the other episode, where there is one
        np.testing.assert_allclose(study.state.rows[-1].returns, expected)
    cube = np.ma.zeros((1, N, N))
    cube[0, 1, 2] = np.ma.masked
    with pytest.raises(InvalidInput, match=r"got nan at \[seed 0, source 1, target 2\]"):
        mbtl.TransferMatrix.of(cube)
    trainer = FunctionTrainer(lambda context, seed: 0, lambda policy, contexts, seeds: hidden)
    assert np.argwhere(np.isnan(trainer.evaluate(0, SPACE.contexts, [0] * N))).tolist() == [[3, 1]]


def test_a_tensor_that_gradients_flow_through_is_told_by_its_values():
    torch = pytest.importorskip("torch")
    study = created(SPACE, budget=1, bounds=(0, 1))
    study.tell(study.ask(), torch.linspace(0.0, 1.0, N, requires_grad=True))
    assert study.value == pytest.approx(0.5)


PLACES = line(60)
X = PLACES.unit[:, 0]


def study_of(**settings):
    return created(PLACES, budget=9, bounds=(0.0, 1.0), **settings)


def test_an_episode_that_crashed_costs_one_episode():
    study, rng = study_of(), np.random.default_rng(0)
    returns = rng.uniform(0.2, 0.8, (60, 100))
    returns[7, 3] = np.nan
    study.tell(30, returns)
    (row,) = study.state.rows
    finite = np.delete(returns[7], 3)
    assert row.returns[7] == pytest.approx(finite.mean())
    assert row.std[7] / np.sqrt(100) == pytest.approx(finite.std(ddof=1) / np.sqrt(99))
    others = np.delete(np.arange(60), 7)
    np.testing.assert_allclose(row.returns[others], returns[others].mean(axis=1))
    np.testing.assert_allclose(row.std[others], returns[others].std(axis=1, ddof=1))


@pytest.mark.parametrize("selector", ["auto", "mbtl", "mbtl-ei", "gp-mbtl", "random"])
def test_a_context_where_all_crashed_is_missing_and_the_study_goes_on(selector):
    def crashed(source):
        returns = 1.0 - np.abs(X[:, None] - X[source]) + np.zeros((60, 4))
        returns[source] = np.nan  # even where it was trained
        return returns

    study = told(study_of(strategy=selector), crashed, 3)
    assert [int(np.isnan(row.returns).sum()) for row in study.state.rows] == [1, 1, 1]
    assert study.ask().number == 3
    assert np.isfinite(study.value)


def test_a_run_bears_crashed_episodes_and_its_report_does():
    def evaluate(policy, contexts, seed):
        returns = np.array([[1.0 - abs(policy - c["x"])] * 5 for c in contexts])
        returns[:, 2] = np.nan
        return returns

    study = study_of()
    result = study.run(train, evaluate, progress=False)
    assert result.fresh is not None
    assert result.value == pytest.approx(float(study.routing.served.mean()), abs=1e-6)


def test_the_one_episode_of_a_context_is_as_noisy_as_usual():
    returns = np.array([[0.0, 2.0, 4.0, 6.0], [1.0, np.nan, np.nan, np.nan]])
    means, deviations = episode_moments(returns)
    assert means.tolist() == [3.0, 1.0]
    assert deviations[1] == pytest.approx(2.0 * deviations[0])  # of one, where there are four


def test_the_chance_of_success_is_one_before_a_failure_and_local_after_it():
    problem, history = SelectionProblem.of(PLACES, budget=9), History(60)
    row = np.full(60, 0.5)
    assert (success_chance(problem, history.with_row(5, row)) == 1.0).all()
    chance = success_chance(problem, history.with_row(5, row).with_failure(40))
    assert chance[40] == pytest.approx(1.0 / (1.0 + np.exp(4.0) / 9.0), abs=1e-3)
    assert chance[5] > 0.99
    assert chance[15:25] == pytest.approx(0.9, abs=0.1)
    again = success_chance(problem, history.with_row(5, row).with_failure(40).with_failure(42))
    assert again[41] < 0.01


@pytest.mark.parametrize(
    ("selector", "most"),
    [*((one, 6) for one in ("specialists", "mbtl", "mbtl-ei", "gp-mbtl")), ("sd-mbtl", 3)],
)
def test_a_region_where_trainings_crash_is_left_after_some(selector, most):
    """30 % of the contexts crash, in one region: of 15 picks at random 4.5 are spent there."""
    problem, chosen, spent = SelectionProblem.of(PLACES, budget=15), get_selector(selector), []
    for low in (0.0, 0.35, 0.7):
        history, crashed = History(60), 0
        rows = 0.9 - 0.8 * np.abs(X[:, None] - X)
        for k in range(15):
            source = chosen.propose(problem, history, np.random.default_rng(k)).source
            if low <= X[source] <= low + 0.3:
                crashed += 1
                history = history.with_failure(source)
            else:
                history = history.with_row(source, rows[source])
        spent.append(crashed)
    assert np.mean(spent) <= most
