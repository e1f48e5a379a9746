"""An engine of others, run for real: Dask with a worker that is killed."""

import os
import signal
from pathlib import Path

import pytest
import quick_problem

import mbtl
from flat import created, ran
from mbtl.trainers import FunctionTrainer

pytestmark = [
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning"),
]


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    """What is here, by processes that others start."""
    folders = [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(folders))


class Deadly:
    """The first training takes its process with it."""

    def __init__(self, marks):
        self.marks = marks

    def __call__(self, context, seed):
        if not self.marks.exists():
            self.marks.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return quick_problem.train(context, seed)


def test_a_study_on_dask_loses_nothing_when_a_worker_process_is_killed(tmp_path):
    distributed = pytest.importorskip("distributed")
    trainer = FunctionTrainer(
        Deadly(tmp_path / "killed"), quick_problem.evaluate, quick_problem.save, quick_problem.load
    )
    study = created(
        quick_problem.SPACE, budget=6, bounds=(-20.0, 0.0), storage=tmp_path / "study.db"
    )
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None,
            worker_dashboard_address=None, silence_logs=50, local_directory=str(tmp_path),
        ) as cluster,
        distributed.Client(cluster) as client,
    ):  # fmt: skip
        ran(study, trainer=trainer, parallel=2, executor=client.get_executor(pure=False))
    assert (tmp_path / "killed").exists()
    assert study.is_finished
    rows = mbtl.load_study(tmp_path).state.rows
    assert sorted(row.pick for row in rows) == list(range(6))
    assert not study.state.failures
    assert study.portfolio(trainer).policy_for({"mass": 1.0}).shape == (2,)
