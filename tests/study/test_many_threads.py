"""One study in many threads, and a study that is sent to another process."""

import copy
import pickle
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from postgres import Server, missing

import mbtl
from flat import created
from mbtl.errors import StudyError
from mbtl.study import StudyFinished
from mbtl.trainers import FunctionTrainer

N, THREADS = 40, 8
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): N})


def row_of(context):
    return 1.0 - np.abs(np.linspace(0.0, 1.0, N) - context["x"])


def train(context, seed):
    return context["x"]


def evaluate(policy, contexts, seed):
    return [1.0 - abs(c["x"] - policy) for c in contexts]


def save(policy, folder):
    (folder / "x").write_text(repr(policy))


def load(folder):
    return float((folder / "x").read_text())


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


def test_one_study_that_eight_threads_tell_and_read_misses_no_row(storage, request):
    study = created(
        SPACE, budget=N, bounds=(0.0, 1.0), strategy="random", storage=storage,
        name=request.node.name,
    )  # fmt: skip
    picks, begin = study.ask(N), threading.Barrier(THREADS)

    def tell(mine):
        begin.wait()
        for pick in mine:
            assert study.tell(pick, row_of(pick.context), policy_object=pick.source)
            assert study.value > 0.0
            assert len(study.trainings) == N

    with ThreadPoolExecutor(THREADS) as threads:
        list(threads.map(tell, [picks[i::THREADS] for i in range(THREADS)]))
    rows = study.state.rows
    assert sorted(row.source for row in rows) == list(range(N))
    assert [study.policies[place] for place in range(N)] == [row.source for row in rows]
    for row in rows:
        np.testing.assert_array_equal(row.returns, row_of(SPACE.context(row.source)))
    if storage is not None:
        assert mbtl.load_study(storage, study.name).value == study.value


def test_eight_threads_that_ask_one_study_share_its_picks(tmp_path):
    settings = {"bounds": (0.0, 1.0), "strategy": "random", "storage": tmp_path / "study.db"}
    study = created(SPACE, budget=2 * THREADS, **settings)

    def work(_):
        sources = []
        while True:
            try:
                pick = study.ask()
            except StudyFinished:
                return sources
            study.tell(pick, row_of(pick.context))
            sources.append(pick.source)

    with ThreadPoolExecutor(THREADS) as threads:
        told = [source for mine in threads.map(work, range(THREADS)) for source in mine]
    assert sorted(told) == sorted({row.source for row in study.state.rows})
    assert len(told) == 2 * THREADS


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
    trainer = FunctionTrainer(train, evaluate, save, load)
    study = created(SPACE, storage=tmp_path / "study.db", trainer=trainer,
                              artifacts=tmp_path / "kept", **settings)  # fmt: skip
    first = study.ask()
    for twin in (pickle.loads(pickle.dumps(study)), copy.deepcopy(study)):
        assert (twin.name, twin.selector, twin.trainer) == (study.name, study.selector, trainer)
        assert twin.folder == tmp_path / "kept"
        assert twin.worker != study.worker
    twin.tell(first, row_of(first.context))
    assert len(study.refresh().rows) == 1
    twin.run(progress=False, report=False)
    assert len(study.refresh().rows) == 3
    with pytest.raises(StudyError, match=r"in memory lives in one process.*make it with storage="):
        pickle.dumps(created(SPACE, **settings))
