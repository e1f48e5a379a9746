"""One study in many threads, and a study that is sent to another process."""

import contextlib
import copy
import pickle
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from line_problem import TRAINER, line
from postgres import Server, missing

import mbtl
from flat import created
from mbtl.errors import StudyError
from mbtl.study import StudyFinished

N, THREADS = 24, 8
SPACE = line(N)


def row_of(context):
    return 1.0 - np.abs(np.linspace(0.0, 1.0, N) - context["x"])


@pytest.fixture(scope="module")
def server():
    if reason := missing():
        pytest.skip(reason)
    with Server() as started:
        yield started.url


@pytest.fixture(params=["memory", "sqlite", "postgres"])
def storage(request, tmp_path):
    if request.param == "postgres":
        return request.getfixturevalue("server")
    return None if request.param == "memory" else tmp_path / "study.db"


def test_one_study_that_eight_threads_ask_tell_and_read_misses_no_row(storage, request):
    study = created(
        SPACE, budget=N, bounds=(0.0, 1.0), strategy="random", storage=storage,
        name=request.node.name,
    )  # fmt: skip
    begin = threading.Barrier(THREADS)

    def work(_):
        begin.wait()
        with contextlib.suppress(StudyFinished):
            while True:
                pick = study.ask()
                assert study.tell(pick, row_of(pick.context), policy_object=pick.source)
                assert study.value > 0.0
                assert len(study.trainings) > pick.number

    with ThreadPoolExecutor(THREADS) as threads:
        list(threads.map(work, range(THREADS)))
    rows = study.state.rows
    assert sorted(row.source for row in rows) == list(range(N))
    assert [study.policies[place] for place in range(N)] == [row.source for row in rows]
    for row in rows:
        np.testing.assert_array_equal(row.returns, row_of(SPACE.context(row.source)))
    if storage is not None:
        assert mbtl.load_study(storage, study.name).value == study.value


def test_what_was_decided_is_written_after_the_state_that_it_was_decided_on():
    """A row told by another thread between deciding and writing would pass for known."""
    study = created(SPACE, budget=3, bounds=(0.0, 1.0), strategy="random")
    (first, second), other = study.ask(2), None

    def slow(state):
        nonlocal other
        other = threading.Thread(target=study.tell, args=(second, row_of(second.context)))
        other.start()
        other.join(0.05)
        return mbtl.study.events.Event("released", {"pick": first.number, "rows": len(state.rows)})

    event = study._commit(slow)
    other.join()
    kinds = [event.kind for event in study.log.read()][-2:]
    assert (event.data["rows"], kinds) == (0, ["released", "told"])


def test_a_pickled_study_is_opened_anew_and_one_in_memory_says_why_not(tmp_path):
    settings = {"budget": 3, "bounds": (0.0, 1.0), "strategy": mbtl.selectors.Random()}
    place = {"storage": tmp_path / "study.db", "artifacts": tmp_path / "kept"}
    study = created(SPACE, trainer=TRAINER, **place, **settings)
    first = study.ask()
    for twin in (pickle.loads(pickle.dumps(study)), copy.deepcopy(study)):
        assert (twin.name, twin.selector, twin.trainer) == (study.name, study.selector, TRAINER)
        assert twin.folder == tmp_path / "kept"
        assert twin.worker != study.worker
    twin.tell(first, row_of(first.context))
    assert len(study.refresh().rows) == 1
    twin.run(progress=False, report=False)
    assert len(study.refresh().rows) == 3
    with pytest.raises(StudyError, match=r"in memory lives in one process.*make it with storage="):
        pickle.dumps(created(SPACE, **settings))
