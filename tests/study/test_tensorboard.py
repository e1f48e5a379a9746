import numpy as np
import pytest
from line_problem import evaluate, line

from flat import created
from mbtl.study.callbacks import TensorBoardCallback
from mbtl.trainers import Progress


def test_v_and_training_scalars_reach_tensorboard(tmp_path):
    reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")

    def train(context, seed, on_progress):
        on_progress(Progress(50, 100, {"episode_return": 7.5}))
        return context["x"]

    study = created(line(9), budget=3, bounds=(0.0, 1.0))
    study.run(train, evaluate, callbacks=[TensorBoardCallback(tmp_path)])
    events = reader.EventAccumulator(str(tmp_path / "study")).Reload()
    assert [e.value for e in events.Scalars("study/V")] == pytest.approx(study.curve, abs=1e-6)
    assert [e.value for e in events.Scalars("study/source")] == [4.0, 7.0, 1.0]
    (scalar,) = events.Scalars("source-0004/episode_return")
    assert (scalar.step, scalar.value) == (50, 7.5)
    assert np.isfinite(study.value)
