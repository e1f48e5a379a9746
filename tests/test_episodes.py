"""Episodes: folds choose and value in turn, luck that is shared is measured, intervals cover."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from mbtl.episodes import Episodes, scatter_of_sum, student
from mbtl.objective import Bounds

UNIT = Bounds(0.0, 1.0)


def coverage():
    """The module that measures coverage for docs/honest-numbers.md."""
    place = Path(__file__).parents[1] / "evidence" / "coverage.py"
    spec = importlib.util.spec_from_file_location("coverage_of_intervals", place)
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_fold_and_the_others_are_the_means_of_their_episodes():
    returns = np.array([[0.0, 1.0, 2.0, 4.0], [np.nan] * 4])
    episodes = Episodes([returns, returns[:, :2]], Bounds(0.0, 2.0))
    at = np.array([0, 1]), np.array([0, 0])
    assert episodes.folds == 2
    assert episodes.held(*at) == pytest.approx(np.array([[0.5, 1.25], [0.0, 0.5]]))
    assert episodes.kept(*at) == pytest.approx(np.array([[1.25, 0.5], [0.5, 0.0]]))


def test_a_row_of_one_episode_is_the_same_in_every_fold():
    episodes = Episodes([np.array([[0.3]]), np.array([[0.1, 0.5]])], UNIT)
    at = np.array([0, 1]), np.array([0, 0])
    assert episodes.held(*at) == pytest.approx(np.array([[0.3, 0.3], [0.1, 0.5]]))
    assert episodes.kept(*at)[0] == pytest.approx([0.3, 0.3])


@pytest.mark.parametrize("shared", [0.0, 0.5, 1.0])
def test_how_much_luck_policies_share_is_measured_from_two_episodes(shared):
    rng = np.random.default_rng(0)
    common, own = rng.standard_normal((1, 400, 2)), rng.standard_normal((4, 400, 2))
    noise = np.sqrt(shared) * common + np.sqrt(1.0 - shared) * own
    noise[0, ::2] = np.nan  # not evaluated there
    found = Episodes(list(np.array([1.0, 2.0, 0.5, 1.0])[:, None, None] * noise), UNIT).own_share
    assert found == pytest.approx(1.0 - shared, abs=0.08)


def test_two_episodes_of_many_contexts_know_the_scatter_of_a_sum():
    variance, freedom = scatter_of_sum(np.tile([[0.0, 1.0]], (50, 1)))
    assert variance == pytest.approx(50 * 0.25)  # each 0.5 / 2
    assert freedom == pytest.approx(3 * 50 - 2)
    assert student(freedom) == pytest.approx(scipy.stats.t.ppf(0.975, 148))
    assert scatter_of_sum(np.zeros((3, 4))) == (0.0, np.inf)
    assert student(np.inf) == pytest.approx(1.96, abs=1e-3)
    assert scatter_of_sum(np.array([[0.0, 1.0]]))[1] == 1.0  # one context: Student's t of one


def test_running_v_is_not_flattered_and_its_intervals_cover():
    """Two skewed episodes, all contexts: the luckiest rows would be 0.05 and more too high."""
    module = coverage()
    found = module.measured(module.Setting(2, skewed=True), 60)
    error, half = found["V, running"].T
    assert abs(error.mean()) < 3.0 * error.std() / np.sqrt(len(error))
    assert half.mean() < 0.1  # not +- 70
    for name in ("V, running", "V, fresh", "a route", "gain"):
        error, half = found[name].T
        assert np.mean(abs(error) <= half) > 0.82  # of 60
