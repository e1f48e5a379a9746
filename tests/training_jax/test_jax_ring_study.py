"""A study of a twin that is paid in steps: its recipe counts episodes, whose steps differ."""

import numpy as np
import pytest

from flat import created

pytest.importorskip("jax", reason="the jax extra is not installed")
pytest.importorskip("gymnasium", reason="the envs extra is not installed")

from mbtl.study.steps.callbacks import StepCallback

from mbtl.cmdps import get_cmdp

RING = get_cmdp("ring-acc", engine="jax").every(13)
"""Holds of 7, 20 and 33 s: episodes of 58, 20 and 13 decisions."""
DECISIONS = (58, 20, 13)


class Stops(StepCallback):
    """An interrupt between the two marks of the second training."""

    left = 3

    def on_trained(self, study, training):
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt


def opened(folder=None):
    trainer = RING.trainer_for("quick", episodes=4, hyperparameters={"hidden": (8,)})
    return created(
        RING, cost="steps", budget=11_000, trainer=trainer, lengths=[800, 1_600], episodes=1,
        strategy="fixed", load_if_exists=True,
        storage=None if folder is None else folder / "study.db",
    )  # fmt: skip


def outcome(study):
    state = study.state
    return [(t.source, t.steps, t.length) for t in state.trainings], state.spent, state.stopped


def test_a_study_of_a_twin_is_charged_what_was_played_and_goes_on_exactly(tmp_path):
    calm = opened()
    calm.run(progress=False)
    for course in calm.state.trainings:
        assert {mark: one.steps for mark, one in course.marks.items()} == {
            0: 2 * DECISIONS[course.source], 1: 4 * DECISIONS[course.source],
        }  # fmt: skip
    assert sorted(t.source for t in calm.state.trainings) == [0, 1, 2]
    with pytest.raises(KeyboardInterrupt):
        opened(tmp_path).run(progress=False, callbacks=[Stops()])
    study = opened(tmp_path)
    done = [t.length for t in study.state.trainings]
    assert done == [1, -1]
    study.run(progress=False)
    assert outcome(study) == outcome(calm)
    np.testing.assert_array_equal(study.state.returns, calm.state.returns)
    prices = study.state.prices
    assert prices.training == 4 * sum(DECISIONS)
    assert prices.evaluation == 3 * sum(DECISIONS)  # every policy once on every context
