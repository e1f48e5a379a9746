"""Engines of others, run for real: Dask and Ray with a worker that is killed, and submitit."""

import os
import signal
import sys
import time
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

import pytest
import quick_problem

import mbtl
from flat import created, ran

pytestmark = [
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning"),
]
PROGRAM = "from mbtl.cli import program; program()"


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    """What is here, by processes that others start."""
    own = Path(__file__).parent
    folders = [str(own), str(own.parent), os.environ.get("PYTHONPATH", "")]
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


@pytest.fixture
def dask(tmp_path):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None,
            worker_dashboard_address=None, silence_logs=50, local_directory=str(tmp_path),
        ) as cluster,
        distributed.Client(cluster) as client,
    ):  # fmt: skip
        yield client.get_executor(pure=False)


@pytest.fixture
def ray():
    ray = pytest.importorskip("ray")

    class Ray(Executor):
        """As docs/cluster.md has it."""

        def submit(self, fn, /, *args, **kwargs):
            return ray.remote(fn).remote(*args, **kwargs).future()

    here = {"PYTHONPATH": os.environ["PYTHONPATH"]}
    ray.init(num_cpus=2, include_dashboard=False, runtime_env={"env_vars": here})
    yield Ray()
    ray.shutdown()


@pytest.mark.parametrize("engine", ["dask", "ray"])
def test_a_study_loses_nothing_when_a_worker_process_is_killed(tmp_path, engine, request):
    trainer = replace(quick_problem.TRAINER, train_fn=Deadly(tmp_path / "killed"))
    study = created(
        quick_problem.SPACE, budget=6, bounds=(-20.0, 0.0), storage=tmp_path / "study.db"
    )
    ran(study, trainer=trainer, parallel=2, executor=request.getfixturevalue(engine))
    assert (tmp_path / "killed").exists()
    assert study.is_finished
    rows = mbtl.load_study(tmp_path).state.rows
    assert sorted(row.pick for row in rows) == list(range(6))
    assert not study.state.failures
    assert study.portfolio(trainer).policy_for({"mass": 1.0}).shape == (2,)


PROBLEM = """
import mbtl, quick_problem as quick
problem = mbtl.CMDP.from_functions('quick', quick.SPACE, train=quick.train, budget=6,
    evaluate=quick.evaluate, save=quick.save, load=quick.load, bounds=(-20.0, 0.0))
"""


def test_submitit_starts_workers_and_they_end_the_study(tmp_path, monkeypatch):
    submitit = pytest.importorskip("submitit")
    (tmp_path / "mine.py").write_text(PROBLEM)
    monkeypatch.chdir(tmp_path)
    study = created(
        quick_problem.SPACE, budget=6, bounds=(-20.0, 0.0), storage=tmp_path / "study.db",
        problem="quick", settings={"switches": {}},
    )  # fmt: skip
    command = ["worker", "study.db", "mine.py:problem", "--json"]
    work = submitit.helpers.CommandFunction([sys.executable, "-c", PROGRAM, *command])
    executor = submitit.LocalExecutor(folder=tmp_path / "logs")
    jobs = [executor.submit(work) for _ in range(2)]
    while not all(job.done() for job in jobs):
        time.sleep(0.05)
    assert all('"finished": true' in job.result() for job in jobs)
    rows = study.refresh().rows
    assert sorted(row.pick for row in rows) == list(range(6))
    assert study.is_finished
