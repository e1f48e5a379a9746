"""Episodes: folds choose and value in turn, luck that is shared is measured, intervals cover."""

import importlib.util
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

import mbtl
from flat import created
from mbtl.episodes import Episodes, completed, scatter_of_sum, student
from mbtl.errors import TrainingFailed
from mbtl.objective import Bounds

UNIT = Bounds(0.0, 1.0)


def coverage():
    """The module that measures coverage for docs/results.md."""
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


def noisy_run(capsys, n, seed, budget, run=mbtl.Study.run, **wishes):
    """The lines of a run with two episodes each, and the true V of its routes."""
    space = mbtl.ContextSpace.grid({mbtl.Linear("load", 0.0, 1.0): n})
    loads = np.array([space.context(i)["load"] for i in range(n)])
    true = lambda at, load: 0.9 - 0.6 * abs(at - load) - 0.2 * np.sin(5.0 * load)  # noqa: E731

    def evaluate(policy, contexts, seeds):
        luck = [0.2 * np.random.default_rng(each).standard_normal(2) for each in seeds]
        return [true(policy, c["load"]) + each for c, each in zip(contexts, luck, strict=True)]

    study = created(space, budget=budget, seed=seed, bounds=(0.0, 1.0), **wishes)
    run(study, lambda context, seed: context["load"], evaluate, report=False)
    trained = loads[list(study.history.sources)]
    return capsys.readouterr().err.splitlines(), true(trained[study.routing.route], loads).mean()


def test_two_episodes_on_20_of_400_contexts_say_v_on_every_line(capsys):
    for seed in range(2):
        lines, truth = noisy_run(capsys, 400, seed, 4, eval_targets=20)
        assert len(lines) == 4  # and no words on how little is known
        said = [re.search(r"V = ([-.\d]+) \+- ([.\d]+), estimated", line) for line in lines]
        value, half = (float(number) for number in said[-1].groups())
        assert abs(value - truth) < half < 0.2
        assert max(float(each.group(2)) for each in said) < 0.4


@pytest.mark.parametrize(
    ("studies", "least"), [(20, 0.85), pytest.param(150, 0.93, marks=pytest.mark.long)]
)
def test_running_v_and_its_gain_are_not_flattered_and_their_intervals_cover(studies, least):
    """Two skewed episodes, all contexts: the luckiest rows would be 0.03 too high.

    The scatter of folds alone, without that they are lucky together, covers 92 and 89 of 100.
    """
    module = coverage()
    found = module.measured(module.Setting(2, skewed=True), studies)
    for name in module.WHAT:
        error, half = found[name].T
        running = name in ("V, running", "gain")
        assert (least if running else 0.85) < np.mean(abs(error) <= half) <= 1.0, name
        if not running:
            continue
        assert abs(error.mean()) < 3.0 * error.std() / np.sqrt(len(error))
        assert half.mean() < 0.075  # 1.96 times the error's true deviation is 0.061, and 0.056


def test_what_is_filled_in_does_not_make_a_mean_surer():
    returns = np.array([[1.0, 3.0, np.nan, np.nan, 8.0], [1.0, 2.0, 3.0, 4.0, 5.0], [np.nan] * 5])
    found = completed(returns, gaps=True)
    assert found.mean(axis=1)[:2] == pytest.approx([4.0, 3.0])
    seen = np.array([1.0, 3.0, 8.0])
    assert found[0].std(ddof=1) / np.sqrt(5) == pytest.approx(seen.std(ddof=1) / np.sqrt(3))
    np.testing.assert_array_equal(found[1], returns[1])
    assert np.isnan(found[2]).all()
    with pytest.raises(TrainingFailed, match="NaN in all of 1 of 3 contexts"):
        completed(returns)
