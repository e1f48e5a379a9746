"""Picks are leases: nobody waits for a dead worker, what is late changes nothing, none shared."""

import contextlib
import pickle
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from line_problem import TRAINER, evaluate, line

import mbtl
from flat import created
from mbtl.errors import InvalidInput, StudyError, UnsavedPolicies
from mbtl.selectors import Proposal
from mbtl.study import Callback, StudyFinished, database
from mbtl.study.heartbeat import Keeper
from mbtl.trainers import Progress

N = 12
SPACE = line(N)


def row(source):
    return 1.0 - 0.1 * np.abs(source - np.arange(N))


class Clock:
    """The time of the database, in the hands of a test."""

    def __init__(self):
        self.now = 1000.0

    def time(self):
        self.now += 1e-3
        return self.now


@pytest.fixture
def clock(monkeypatch):
    made = Clock()
    monkeypatch.setattr(database, "time", made)
    return made


@pytest.fixture
def place(tmp_path):
    created(SPACE, budget=4, bounds=(0.0, 1.0), strategy="random", storage=tmp_path / "study.db")
    return tmp_path


def kinds(study):
    return [event.kind for event in study.log.read()]


class Slow:
    """Counts its proposals, each of which takes a moment."""

    name = "slow"

    def __init__(self, made):
        self.made = made

    def propose(self, problem, history, rng):
        self.made.append(history.pending)
        time.sleep(0.02)
        return Proposal(int(np.flatnonzero(history.open_mask(problem.n))[0]), "first")


def test_ten_askers_make_ten_proposals(tmp_path):
    """Each used to be thrown away when somebody else was faster: 53 for ten askers."""
    made = []
    settings = {"budget": 10, "strategy": Slow(made), "storage": tmp_path / "study.db"}
    created(SPACE, **settings)

    def ask(_):
        return created(SPACE, load_if_exists=True, **settings).ask().source

    with ThreadPoolExecutor(10) as threads:
        assert sorted(threads.map(ask, range(10))) == list(range(10))
    assert len(made) == 10


@pytest.mark.parametrize("error", [RuntimeError("a slip"), KeyboardInterrupt()])
def test_a_proposal_that_fails_leaves_the_next_asker_nothing_to_wait_for(place, error):
    class Broken:
        name = "random"

        def propose(self, problem, history, rng):
            raise error

    study, other = mbtl.load_study(place), mbtl.load_study(place)
    study.selector = Broken()
    with pytest.raises(type(error)):
        study.ask()
    assert other.refresh().proposing is None
    assert other.ask().number == 0


def test_a_proposer_that_died_is_succeeded_when_its_time_is_over(place, clock):
    dead, other = mbtl.load_study(place), mbtl.load_study(place)
    dead._commit(lambda state: mbtl.study.ask.claim(state, dead.watch(), 9.0, "dead"))
    assert mbtl.study.ask.claim(other.refresh(), other.watch(), 9.0, "other") is None
    clock.now += 100.0
    assert other.ask().number == 0
    assert not dead._propose("0", None)


@pytest.mark.parametrize("again", [False, True])
def test_a_pick_that_was_taken_over_before_its_asker_heard_of_it_has_one_holder(
    place, clock, again
):
    """A server that restarts may write a claim and answer when its lease has ended."""
    first, second, taken = mbtl.load_study(place), mbtl.load_study(place), []
    if again:
        first.release(first.ask(lease=30.0))
    append = first.log.append

    def append_and_hear_late(event, *, after):
        number = append(event, after=after)
        if event.data.get("seconds") == 30.0 and not taken:
            clock.now += 31.0
            taken.append(second.ask(lease=60.0))
        return number

    first.log.append = append_and_hear_late
    mine = first.ask(lease=30.0)
    assert [taken[0].number, mine.number] == [0, 1]
    assert first.tell(mine, row(mine.source))
    assert second.tell(taken[0], row(taken[0].source))


def test_a_training_whose_processes_all_die_is_told_of(place, clock, capsys):
    lost = mbtl.load_study(place)
    for often in (0, 1, 2):
        pick = lost.ask(lease=30.0)
        assert lost.state.picks[pick.number].abandoned == often
        clock.now += 31.0
        lost = mbtl.load_study(place)
    with pytest.warns(UnsavedPolicies):
        lost.run(lambda context, seed: 0.0, lambda policy, contexts, seeds: np.zeros(len(contexts)))
    assert "pick 1 was begun 3 times by processes that ended without a word" in (
        capsys.readouterr().err
    )


def test_a_silent_worker_is_succeeded_and_its_row_comes_late(place, clock):
    first, second = mbtl.load_study(place), mbtl.load_study(place)
    slow = first.ask(lease=30.0)
    assert second.ask(lease=30.0).number == 1
    clock.now += 31.0
    taken = second.ask(lease=30.0)
    assert taken == slow
    assert taken.token != slow.token
    assert not first.heartbeat(slow)
    assert not first.tell(slow, row(slow.source), policy_object="theirs")
    assert not first.fail(slow, "out of memory")
    assert second.tell(taken, row(taken.source))
    assert not first.tell(slow, row(slow.source))  # also after the answer
    assert (len(first.state.rows), len(first.state.failures)) == (1, 0)
    late = [event.data["outcome"] for event in second.log.read() if event.kind == "late"]
    assert late == ["told", "failed", "told"]
    assert not first.policies
    late = next(event for event in second.log.read() if event.kind == "late")
    assert np.array_equal(late.arrays["returns"][:, 0], row(slow.source))
    with pytest.raises(StudyError, match="answered before"):
        second.tell(taken, row(taken.source))


def test_heartbeats_keep_a_lease(place, clock):
    study, other = mbtl.load_study(place), mbtl.load_study(place)
    pick = study.ask(lease=30.0)
    other.refresh()
    for _ in range(5):
        clock.now += 20.0
        assert study.heartbeat(pick)
        assert other.orphans == []
    clock.now += 31.0
    assert other.orphans == [0]
    assert study.heartbeat(pick)  # late, and nobody had noticed
    assert other.orphans == []


def test_a_lease_without_an_end_is_only_given_back(place, clock):
    study, other = mbtl.load_study(place), mbtl.load_study(place)
    pick = study.ask()
    clock.now += 1e6
    assert other.ask().number == 1
    assert [p.number for p in other.open_picks()] == [0, 1]
    other.release(0)
    assert not study.heartbeat(pick)
    assert other.ask() == pick
    with pytest.raises(StudyError, match=r"taken over by .*; it is theirs"):
        study.release(pick)
    with pytest.raises(StudyError, match="pick 3 is not open"):
        study.release(2)


def test_what_was_given_back_may_still_be_told_until_somebody_takes_it(place):
    study = mbtl.load_study(place)
    pick = study.ask()
    study.release(pick)
    assert study.tell(pick, row(pick.source))


def test_a_pick_is_answered_from_another_process(place):
    """As a batch system does: one process asks, a job per number trains and tells."""
    asked = pickle.loads(pickle.dumps(mbtl.load_study(place).ask()))
    job = mbtl.load_study(place)
    pick = job.pick(0)
    assert (pick, pick.token, pick.seed) == (asked, asked.token, asked.seed)
    assert job.tell(pick, row(pick.source))
    assert not job.open_picks()
    with pytest.raises(StudyError, match="from 0 to 0 so far, got 1"):
        job.pick(1)


@pytest.mark.parametrize("lease", [0.0, -1.0, float("inf"), float("nan")])
def test_a_lease_is_a_number_of_seconds(place, lease):
    with pytest.raises(InvalidInput, match="seconds > 0"):
        mbtl.load_study(place).ask(lease=lease)


# ---- rows that are wrong -----------------------------------------------------------------------


def test_a_wrong_row_is_taken_back_and_its_pick_may_be_tried_again(place):
    study = mbtl.load_study(place)
    for level in ("a", "wrong", "c"):
        pick = study.ask()
        study.tell(pick, row(pick.source), policy_object=level)
    other = mbtl.load_study(place)
    other.policies = dict(study.policies)
    wrong = study.state.rows[1]
    study.void(wrong, "the simulator was misconfigured")
    for seen in (study, other, mbtl.load_study(place)):
        seen.refresh()
        assert len(seen.state.rows) == len(seen.history) == len(seen.curve) == 2
        assert seen.state.failures[0].reason == "the simulator was misconfigured"
    assert study.policies == other.policies == {0: "a", 1: "c"}
    with pytest.raises(StudyError, match="taken back before"):
        other.void(wrong, "again")
    with pytest.raises(StudyError, match="got 2"):
        other.void(2, "there is none")
    study.retry(wrong.pick)
    again = study.ask()
    assert again.source == wrong.source
    assert study.tell(again, row(again.source))
    assert len(study.state.rows) == 3
    assert "voided" in kinds(study)


# ---- runs --------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::mbtl.errors.UnsavedPolicies")
def test_a_training_that_is_taken_away_stops_at_its_next_report(place, monkeypatch):
    study, keepers, lost = mbtl.load_study(place), [], []
    enter = Keeper.__enter__
    monkeypatch.setattr(Keeper, "__enter__", lambda keeper: keepers.append(keeper) or enter(keeper))

    class Ear(Callback):
        def on_lost(self, study, pick):
            lost.append(pick.number)

    trained = []

    def train(context, seed, on_progress):
        trained.append(context["x"])
        on_progress(Progress(1, 2, {"episode_return": 0.5}))
        if len(trained) == 1:
            mbtl.load_study(place).release(0)
        keepers[0].look()  # as the thread does, every third of a lease
        on_progress(Progress(2, 2))
        return context["x"]

    study.run(train, evaluate, report=False, callbacks=[Ear()])
    assert lost == [0]
    assert study.is_finished
    assert len(study.state.rows) == 4
    assert len(trained) == 5
    assert len(study.log.beats()) == 4  # of all but the one that was lost
    assert not list(place.glob(".study.db.*.lock"))


def test_a_run_does_what_another_leaves_undone(place, clock, monkeypatch):
    """The last training is held by a worker that is silent for ever."""
    dead = mbtl.load_study(place)
    pick = dead.ask(lease=5.0)
    waited = []

    def sleep(seconds):
        waited.append(seconds)
        clock.now += 1.0

    monkeypatch.setattr(mbtl.study.study.time, "sleep", sleep)
    study = mbtl.load_study(place)
    study.run(trainer=TRAINER, report=False)
    assert study.is_finished
    assert waited
    assert study.state.rows[-1].pick == pick.number
    with pytest.raises(StudyFinished):
        study.ask()


def test_an_empty_place_among_locks_says_nothing_and_a_strange_name_opens_no_file(place):
    presence = mbtl.load_study(place).presence
    assert not presence.is_gone("never-seen")
    assert not presence.is_gone("../../etc/passwd")
    presence.enter("a-worker")
    other = mbtl.load_study(place).presence
    assert not other.is_gone("a-worker")
    presence.leave("a-worker", [])
    assert not other.is_gone("a-worker")


def test_an_end_that_leaves_work_behind_is_known_until_the_last_of_it_is_taken_over(place):
    """So it is on a full disk, where nothing can be given back any more."""
    full = mbtl.load_study(place)
    with Keeper(full, 60.0):
        held = [full.ask(lease=60.0), full.ask(lease=60.0)]
    first, second = mbtl.load_study(place), mbtl.load_study(place)
    assert first.orphans == second.orphans == [0, 1]  # whoever looks first hides it from nobody
    assert first.ask() == held[0]
    assert list(place.glob(".study.db.*.lock"))
    assert second.ask() == held[1]
    assert not list(place.glob(".study.db.*.lock"))


# ---- many threads, and other processes ----------------------------------------------------------

THREADS = 6


def test_one_study_that_many_threads_ask_tell_and_read_misses_no_row(storage, request):
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
                assert study.tell(pick, row(pick.source), policy_object=pick.source)
                assert study.value > 0.0
                assert len(study.trainings) > pick.number

    with ThreadPoolExecutor(THREADS) as threads:
        list(threads.map(work, range(THREADS)))
    rows = study.state.rows
    assert sorted(one.source for one in rows) == list(range(N))
    assert [study.policies[place] for place in range(N)] == [one.source for one in rows]
    for one in rows:
        np.testing.assert_array_equal(one.returns, row(one.source))
    if storage is not None:
        assert mbtl.load_study(storage, study.name).value == study.value


def test_what_was_decided_is_written_after_the_state_that_it_was_decided_on():
    """A row told by another thread between deciding and writing would pass for known."""
    study = created(SPACE, budget=3, bounds=(0.0, 1.0), strategy="random")
    (first, second), other = study.ask(2), None

    def slow(state):
        nonlocal other
        other = threading.Thread(target=study.tell, args=(second, row(second.source)))
        other.start()
        other.join(0.05)
        return mbtl.study.events.Event("released", {"pick": first.number, "rows": len(state.rows)})

    event = study._commit(slow)
    other.join()
    kinds = [event.kind for event in study.log.read()][-2:]
    assert (event.data["rows"], kinds) == (0, ["released", "told"])
