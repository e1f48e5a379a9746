"""Where workers wait for a proposal, one of them proposes for the others, too."""

import numpy as np
import pytest
from line_problem import TRAINER

import mbtl
from flat import created, ran
from mbtl.errors import StorageError
from mbtl.selectors import MBTL
from mbtl.study import StudyFinished, ask
from mbtl.study import study as study_module
from mbtl.study.leases import asker

N = 40
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): N})
HELD = 5
"""Picks that are under way."""
WAITING = ("anna", "bert", "carl")


class Counting(MBTL):
    """Notes what it knew at each proposal."""

    def propose(self, problem, history, rng):
        self.__dict__.setdefault("knew", []).append((len(history), len(history.pending)))
        return super().propose(problem, history, rng)


def row(source):
    return 1.0 - 0.02 * np.abs(source - np.arange(N))


def settings_of(place, **wishes):
    return {
        "budget": 30, "bounds": (0.0, 1.0), "storage": place / "study.db", "load_if_exists": True,
        **wishes,
    }  # fmt: skip


@pytest.fixture
def busy(tmp_path):
    """A study with two rows, and three workers that wait for somebody to propose."""
    return begun(tmp_path)


def wait(study):
    for name in (*WAITING, study.worker):  # the last one has got a pick meanwhile
        study.log.beat(asker(name), 600.0)


def begun(place, **wishes):
    wishes = settings_of(place, **wishes)
    crowd = created(SPACE, strategy="mbtl", **wishes)
    for source in (3, 35):
        crowd.tell(source, row(source))
    for _ in range(HELD):
        crowd.ask(lease=600.0)
    wait(crowd)
    one, another = (created(SPACE, strategy=Counting(), **wishes) for _ in range(2))
    return crowd, one, another


def test_one_worker_proposes_for_the_next_ones_what_they_would_have_proposed(busy, tmp_path):
    _, one, another = busy
    picks = [study.ask(lease=600.0) for study in (one, another, another, another)]
    assert one.selector.knew == [(2, HELD + i) for i in range(4)]
    assert not hasattr(another.selector, "knew")
    assert [pick.number for pick in picks] == [HELD + i for i in range(4)]
    (tmp_path / "alone").mkdir()
    _, alone, _ = begun(tmp_path / "alone")
    alone.proposes_ahead = False
    assert picks == [alone.ask(lease=600.0) for _ in range(4)]


def test_picks_ahead_miss_no_more_answers_than_there_were_of_them(busy):
    crowd, one, another = busy
    one.ask(lease=600.0)
    held = crowd.open_picks()
    for pick in held[:3]:
        crowd.tell(pick, row(pick.source))
    another.ask(lease=600.0)
    assert not hasattr(another.selector, "knew")
    crowd.fail(held[3], "diverged")
    another.ask(lease=600.0)
    assert another.selector.knew[0] == (5, HELD - 2)


@pytest.mark.parametrize("change", ["void", "tell", "deterministic"])
def test_a_pick_ahead_that_does_not_hold_any_more_is_proposed_anew(busy, change):
    crowd, one, another = busy
    one.ask(lease=600.0)
    if change == "void":
        crowd.void(0, "wrong")
    elif change == "tell":
        (source,) = one.state.ahead[0]["sources"]
        crowd.tell(source, row(source))
    else:
        another.proposes_ahead = False
    mine = another.ask(lease=600.0)
    assert another.selector.knew[0] == (2 + (change == "tell") - (change == "void"), HELD + 1)
    assert sum(pick.source == mine.source for pick in another.state.picks) == 1


def test_who_waits_says_so_and_is_proposed_for(tmp_path, monkeypatch):
    study = created(SPACE, strategy="mbtl", **settings_of(tmp_path))
    waiting = mbtl.load_study(tmp_path / "study.db")
    claim = ask.claim(study.state, study.watch(), 60.0, study.worker)
    study._commit(lambda state: claim)

    def ended(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(study_module._Turn, "wait", ended)
    with pytest.raises(KeyboardInterrupt):
        waiting.ask()
    assert study._propose(claim.data["token"], 60.0)
    assert len(study.state.ahead) == 1
    assert waiting.ask().number == 1


def test_a_worker_alone_proposes_nothing_ahead(tmp_path):
    study = created(SPACE, strategy="mbtl", **settings_of(tmp_path))
    study.ask(3, lease=600.0)
    study.run(trainer=TRAINER, report=False, progress=False)
    assert not any("ahead" in event.data for event in study.log.read())
    assert not study.log.beats()


def test_a_run_in_whole_batches_proposes_nothing_ahead(busy):
    crowd, one, _ = busy
    for pick in crowd.open_picks():
        crowd.release(pick)
    ran(one, trainer=TRAINER, report=False, progress=False, deterministic=True)
    assert not one.proposes_ahead
    assert not any("ahead" in event.data for event in one.log.read())


def test_a_study_that_a_prediction_may_end_proposes_nothing_ahead(tmp_path):
    study = created(SPACE, strategy="auto", stop_gain=1e-6, **settings_of(tmp_path))
    wait(study)
    study.ask(lease=600.0)
    assert not study.state.ahead


@pytest.mark.parametrize(
    "wishes", [{"budget": HELD + 2}, {"cost_budget": HELD + 2.5, "costs": [1] * N}]
)
def test_picks_ahead_spend_neither_more_trainings_nor_more_cost_than_there_is(tmp_path, wishes):
    _, one, another = begun(tmp_path, **wishes)
    one.ask(lease=600.0)
    assert len(one.state.ahead) == 1
    another.ask(lease=600.0)
    with pytest.raises(StudyFinished):
        another.ask(lease=600.0)


@pytest.mark.parametrize("change", [{"sources": [N]}, {"notes": "text"}, {"reason": None}])
def test_a_damaged_pick_ahead_is_refused_in_a_sentence(busy, change):
    _, one, another = busy
    append = one.log.append

    def damaged(event, *, after):
        if "ahead" in event.data:
            event.data["ahead"][0].update(change)
        return append(event, after=after)

    one.log.append = damaged
    with pytest.raises(StorageError, match="`ahead` must be a list of proposals"):
        one.ask(lease=600.0)
    with pytest.raises(StorageError, match="damaged"):
        another.ask()
