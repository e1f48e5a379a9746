"""Studies end where nothing is left to gain, and by levels only where V surely has reached them."""

import numpy as np
import pytest

import mbtl
from flat import created
from mbtl.study import StudyFinished

N = 12
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): N})


def study_of(**settings):
    return created(SPACE, **{"budget": 8, "bounds": (0.0, 500.0), **settings})


def tell(study, level, episodes=2, noise=0.0):
    pick = study.ask()
    rng = np.random.default_rng(pick.source)
    study.tell(pick, level + noise * rng.standard_normal((N, episodes)))


def test_a_study_ends_where_v_is_as_large_as_it_can_be():
    study = study_of(stop_left=0.005, best_return=500.0, strategy="mbtl")
    tell(study, 490.0)
    assert study.stop_reason is None
    tell(study, 498.0)
    assert study.stop_reason == "V = 0.9960 is within 0.005 of the largest there can be, 1"
    with pytest.raises(StudyFinished):
        study.ask()


def test_the_smallest_return_is_the_best_where_returns_are_minimised():
    study = study_of(stop_left=0.005, best_return=0.0, direction="minimize")
    tell(study, 1.0)
    assert "within 0.005 of the largest" in study.stop_reason


def test_without_those_wishes_the_budget_is_spent():
    study = study_of(budget=3, strategy="mbtl")
    for _ in range(3):
        tell(study, 500.0)
    assert study.stop_reason == "the budget of 3 trainings is spent"


def test_a_study_ends_where_all_trainings_left_together_are_predicted_to_gain_nothing():
    study = study_of(stop_left=0.005)
    for _ in range(3):
        tell(study, 400.0)
    with pytest.raises(StudyFinished, match="all trainings that are left together gain less than"):
        study.ask()
    assert study.is_finished


def test_a_study_goes_on_while_other_contexts_promise_something():
    study = study_of(stop_left=0.005)
    for _ in range(4):
        pick = study.ask()
        reach = 450.0 * np.exp(-np.square((np.arange(N) - pick.source) / 1.5))
        study.tell(pick, np.repeat(reach[:, None], 2, axis=1))
    assert study.stop_reason is None
    study.ask()


def test_a_lucky_mean_does_not_reach_a_level():
    lucky = study_of(stop_value=0.8, strategy="mbtl")
    tell(lucky, 405.0, episodes=3, noise=120.0)
    now = lucky.routing.value
    assert now.error > 0.01
    assert now.value - 1.28 * now.error < 0.8
    assert lucky.stop_reason is None
    sure = study_of(stop_value=0.8, strategy="mbtl")
    tell(sure, 405.0)
    assert sure.stop_reason == "V = 0.8100 reaches the level 0.8"
