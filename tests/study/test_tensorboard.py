import numpy as np
import pytest

import mbtl
from flat import created
from mbtl.study.callbacks import TensorBoardCallback
from mbtl.trainers import FunctionTrainer, Progress, Trained

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 9})


class Reporting(FunctionTrainer):
    def train(self, contexts, seed, *, on_progress=None, **asked):
        on_progress(Progress(50, 100, {"episode_return": 7.5}))
        return Trained(contexts[0]["x"])


def test_v_and_training_scalars_reach_tensorboard(tmp_path):
    event_accumulator = pytest.importorskip(
        "tensorboard.backend.event_processing.event_accumulator"
    )

    def evaluate(policy, contexts, seeds):
        return [1 - abs(c["x"] - policy) for c in contexts]

    study = created(SPACE, budget=3, bounds=(0.0, 1.0))
    study.run(trainer=Reporting(None, evaluate), callbacks=[TensorBoardCallback(tmp_path)])
    events = event_accumulator.EventAccumulator(str(tmp_path / "study")).Reload()
    assert [e.value for e in events.Scalars("study/V")] == pytest.approx(study.curve, abs=1e-6)
    assert [e.value for e in events.Scalars("study/source")] == [4.0, 7.0, 1.0]
    (scalar,) = events.Scalars("source-0004/episode_return")
    assert (scalar.step, scalar.value) == (50, 7.5)
    assert np.isfinite(study.value)
