"""Which numbers a study takes: those that can be computed with. Others end nothing."""

import re

import numpy as np
import pytest

import mbtl
from flat import created
from mbtl.errors import InvalidInput, TrainingFailed
from mbtl.plain import LARGEST
from mbtl.selectors import selector_names
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


def test_a_run_defers_what_broke_and_goes_on():
    study = created(SPACE, budget=3, bounds=(0, 1), strategy="equidistant")

    def evaluate(policy, contexts, seeds):
        returns = np.array([[1 - abs(c["x"] - policy)] * 3 for c in contexts])
        return returns + np.array([0, 1e160, -1e160]) if policy == 0.5 else returns

    for _ in range(2):
        result = study.run(lambda context, seed: context["x"], evaluate, report=False)
        assert len(result.trainings) == 3
        assert len(study.state.rows) == 2
        (deferred,) = study.state.deferred.values()
        assert "returns must be finite and within 1e+30" in deferred.reason


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


@pytest.mark.parametrize("fact", ["seconds", "steps", "cost"])
def test_what_a_training_took_is_not_negative(fact):
    with pytest.raises(InvalidInput, match=rf"{fact} must be finite, from 0 to 1e\+30, got -5"):
        mbtl.create_study(SPACE, budget=1).tell(0, ROW, **{fact: -5})


def test_deviations_are_not_negative():
    with pytest.raises(InvalidInput, match="std must be deviations from 0"):
        mbtl.TransferMatrix.of(np.zeros((1, N, N)), std=-np.ones((1, N, N)))
