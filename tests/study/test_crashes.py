"""Where simulators crash: an episode costs itself, and regions that crash are learnt to be such."""

import numpy as np
import pytest
from line_problem import line, train

from flat import created
from mbtl.episodes import episode_moments
from mbtl.errors import TrainingFailed
from mbtl.history import History
from mbtl.selectors import get_selector
from mbtl.selectors.base import SelectionProblem, success_chance

SPACE = line(60)
X = SPACE.unit[:, 0]


def study_of(**settings):
    return created(SPACE, budget=9, bounds=(0.0, 1.0), **settings)


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
    study = study_of(strategy=selector)
    for _ in range(3):
        pick = study.ask()
        returns = 1.0 - np.abs(X[:, None] - X[pick.source]) + np.zeros((60, 4))
        returns[pick.source] = np.nan  # even where it was trained
        study.tell(pick, returns)
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


@pytest.mark.parametrize("wrong", [np.full((60, 2), np.nan), np.full(60, np.inf)])
def test_an_evaluation_that_gives_nothing_has_failed(wrong):
    with pytest.raises(TrainingFailed, match="finite"):
        study_of().tell(3, wrong)


def test_the_one_episode_of_a_context_is_as_noisy_as_usual():
    returns = np.array([[0.0, 2.0, 4.0, 6.0], [1.0, np.nan, np.nan, np.nan]])
    means, deviations = episode_moments(returns)
    assert means.tolist() == [3.0, 1.0]
    assert deviations[1] == pytest.approx(2.0 * deviations[0])  # of one, where there are four


def test_the_chance_of_success_is_one_before_a_failure_and_local_after_it():
    problem, history = SelectionProblem.of(SPACE, budget=9), History(60)
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
    problem, chosen, spent = SelectionProblem.of(SPACE, budget=15), get_selector(selector), []
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
