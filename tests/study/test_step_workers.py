"""Several workers on one study that is paid in steps: leases, successors, and one budget."""

import json
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from step_problem import Slow, opened, outcome
from warm_strategy import Warm

import mbtl
from mbtl.actions import Evaluate, Extend, Policy, Start, Stop, Wait
from mbtl.errors import InvalidInput, StudyMismatch
from mbtl.study.steps.callbacks import StepCallback
from mbtl.study.storage import Conflict

PROGRAM = Path(__file__).parent / "step_problem.py"


class Slower(Slow):
    """So that several really work at the same time."""

    def work(self):
        time.sleep(0.002)


def together(folder, count=3, **settings):
    """Workers of one study in threads, each with a study object and a trainer of its own."""
    opened(Slow(), folder, **settings)
    trainers, troubles = [Slower() for _ in range(count)], []

    def work(trainer):
        try:
            opened(trainer, folder, **settings).run(progress=False, report=False)
        except BaseException as error:
            troubles.append(error)

    threads = [threading.Thread(target=work, args=(trainer,)) for trainer in trainers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert troubles == []
    return opened(Slow(), folder, **settings), trainers


@pytest.mark.parametrize("strategy", ["pilot", "fixed", "halving", "asha", "committee", Warm()])
def test_what_workers_have_run_is_charged_once_and_nothing_is_done_twice(tmp_path, strategy):
    study, trainers = together(tmp_path, strategy=strategy, budget=250_000)
    prices = study.state.prices
    ran = {what: sum(t.ran[what] for t in trainers) for what in ("steps", "checks", "evaluation")}
    assert prices.training + prices.extension == ran["steps"]
    assert (prices.checks, prices.evaluation) == (ran["checks"], ran["evaluation"])
    assert study.state.spent <= 250_000
    assert study.is_finished
    assert not study.state.under_way
    alone = [t.source for t in study.state.trainings if not t.on]
    assert len(set(alone)) == len(alone)
    assert study.value > 0.8
    evaluated = [e for e in study.events() if e.kind == "evaluated"]
    seen = [(e.data["training"], e.data["length"], t) for e in evaluated for t in e.data["targets"]]
    assert len(set(seen)) == len(seen)


@pytest.mark.parametrize("strategy", ["pilot", "fixed", "asha"])
def test_workers_are_at_trainings_at_the_same_time(tmp_path, strategy):
    study, trainers = together(tmp_path, strategy=strategy, budget=250_000)
    assert sum(trainer.ran["steps"] > 0 for trainer in trainers) > 1
    busy, most = set(), 0
    for event in study.events():
        if event.kind == "decided":
            busy.add(event.data["number"])
        elif event.kind in ("evaluated", "halted", "failed"):
            busy.discard(event.data["decision"])
        elif event.kind == "trained":
            course = study.state.trainings[event.data["training"]]
            if event.data["ended"] or event.data["mark"] >= course.length:
                busy.discard(event.data["decision"])
        most = max(most, len(busy))
    assert most > 1


@pytest.mark.parametrize("budget", [20_000, 60_000, 110_000, 170_000])
def test_workers_never_spend_more_than_there_is(tmp_path, budget):
    study, _ = together(tmp_path, count=4, strategy="fixed", budget=budget)
    assert study.state.spent <= budget
    assert study.state.policies


def test_alone_a_stored_study_does_what_one_in_memory_does(tmp_path):
    calm = opened(Slow())
    calm.run(progress=False)
    stored = opened(Slow(), tmp_path)
    stored.run(progress=False)
    assert outcome(stored) == outcome(calm)


def test_a_worker_that_is_killed_is_succeeded_from_its_last_mark(tmp_path):
    calm = opened(Slow())
    calm.run(progress=False)
    opened(Slow(), tmp_path)
    run = subprocess.run(
        [sys.executable, PROGRAM, tmp_path, "45"], capture_output=True, text=True, check=False
    )
    assert run.returncode == -signal.SIGKILL
    trainer = Slow()
    left = opened(trainer, tmp_path)
    (held,) = left.state.under_way.values()
    assert held.lease is not None
    done = left.state.prices.training + left.state.prices.extension
    assert done > 0
    left.run(progress=False)  # at once: the lock of the dead process is free
    assert outcome(left) == outcome(calm)
    prices = left.state.prices
    assert trainer.ran["steps"] == prices.training + prices.extension - done


class Meddles(StepCallback):
    """Takes the action of a worker over while it trains."""

    def __init__(self, other):
        self.other, self.taken = other, False

    def on_progress(self, study, training, progress):
        if progress.step < 20_000 or self.taken:
            return
        self.taken = True
        (number,) = self.other.refresh().under_way
        claim = {"decision": number, "token": "theirs", "worker": "other-1", "lease": 600.0}
        self.other.append("claimed", claim)
        time.sleep(1.0)  # heartbeats hear of it


def test_a_worker_whose_action_was_taken_over_stops_and_records_nothing(tmp_path):
    trainer = Slow()
    study, other = opened(trainer, tmp_path), opened(Slow(), tmp_path)
    told = []

    class Waits(StepCallback):
        def on_waiting(self, study):
            told.append(study.state.spent)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study.run(progress=False, lease=0.1, callbacks=[Meddles(other), Waits()])
    assert told == [16_000 + study.state.prices.checks]  # what it had recorded before
    assert trainer.ran["steps"] <= 22_000  # it was on its way to 32,000
    assert study.state.under_way[0].lease.token == "theirs"
    assert [e.kind for e in study.events()][-2:] == ["trained", "claimed"]


def test_an_answer_under_an_old_lease_is_refused(tmp_path):
    class Quiet(Slow):
        """It does not report, so it hears of nothing before its end."""

        taken = False

        def on_one(self, context, seed, steps, **given):
            reached = super().on_one(context, seed, steps, state=given["state"])
            if not self.taken:
                self.taken = True
                (number,) = other.refresh().under_way
                claim = {"decision": number, "token": "x", "worker": "other-1", "lease": 0.01}
                other.append("claimed", claim)
                time.sleep(0.1)
            return reached

    other = opened(Slow(), tmp_path)
    study = opened(Quiet(), tmp_path)
    study.run(progress=False)  # refused, then taken over again, since the other one is silent
    kinds = [(e.kind, e.data.get("token")) for e in study.events() if e.kind != "equipped"]
    assert kinds[2] == ("claimed", "x")
    assert kinds[3][0] == "claimed"
    assert ("trained", "x") not in kinds
    calm = opened(Slow())
    calm.run(progress=False)
    assert outcome(study) == outcome(calm)


@pytest.mark.parametrize("strategy", ["committee", Warm()])
def test_a_strategy_that_does_not_work_in_parallel_is_asked_when_nothing_is_under_way(
    tmp_path, strategy
):
    study, _ = together(tmp_path, strategy=strategy, budget=150_000)
    calm = opened(Slow(), strategy=strategy)
    calm.run(progress=False, report=False)
    assert study.state.spent == calm.state.spent
    np.testing.assert_array_equal(study.state.returns, calm.state.returns)


def test_a_worker_that_need_not_wait_leaves_the_last_action_to_others(tmp_path):
    study = opened(Slow(), tmp_path, strategy=Warm())
    claim = {"token": "theirs", "worker": "other-1", "lease": 600.0}
    action = {"do": "start", "source": 5, "length": 3}
    study.append("decided", {"number": 0, "action": action, "seconds": 0.0, **claim})
    trainer = Slow()
    opened(trainer, tmp_path, strategy=Warm()).run(progress=False, wait=False)
    assert not any(trainer.ran.values())


def test_a_budget_raised_meanwhile_is_spent_by_those_that_run(tmp_path):
    class Extends(StepCallback):
        done = False

        def on_trained(self, study, training):
            if not self.done:
                self.done = True
                opened(Slow(), tmp_path).extend(250_000)

    study = opened(Slow(), tmp_path)
    study.run(progress=False, callbacks=[Extends()])
    assert study.spec.budget == 250_000
    assert study.state.spent > 150_000


class Disturbed:
    """Begins on one context; while it decides, another worker records something."""

    name, in_parallel = "disturbed", True

    def __init__(self, news):
        self.news, self.asked = news, 0

    def decide(self, problem, trail, rng):
        self.asked += 1
        if self.news is not None:
            self.news()
            self.news = None
        return Wait() if 2 in trail.begun else Start(2, 0)


CAME_TO_A_MARK = {
    "training": 0, "source": 5, "mark": 0, "steps": 8_000, "checks": 0, "ended": False,
    "policy": None, "sha256": None, "seconds": 1.0, "decision": 0, "token": "theirs",
}  # fmt: skip
THEIRS = {"token": "theirs", "worker": "other-1", "lease": 600.0, "seconds": 0.0}


def decision(number, source):
    return {"number": number, "action": {"do": "start", "source": source, "length": 3}, **THEIRS}


@pytest.mark.parametrize(
    ("kind", "data", "asked", "begun"),
    [
        ("trained", CAME_TO_A_MARK, 2, [5, 2]),
        ("decided", decision(1, 7), 3, [5, 7, 2]),
        ("decided", decision(1, 2), 2, [5, 2]),
    ],
    ids=["a mark", "another context", "the same context"],
)
def test_a_decision_stands_unless_others_have_decided_meanwhile(tmp_path, kind, data, asked, begun):
    other = opened(Slow(), tmp_path, strategy=Disturbed(None), budget=400_000)
    other.append("decided", decision(0, 5))
    strategy = Disturbed(lambda: other.append(kind, data))
    study = opened(Slow(), tmp_path, strategy=strategy, budget=400_000)
    study.run(progress=False, report=False, wait=False)
    decided = [e.data["action"] for e in study.events() if e.kind == "decided"]
    assert [one["source"] for one in decided if one["do"] == "start"] == begun
    assert strategy.asked == asked  # the last time for nothing more


def elsewhere(folder, store):
    """The study as a worker opens it that was given other artifacts."""
    return mbtl.StepStudy.load(folder / "study.db", trainer=Slow(), artifacts=store)


@pytest.mark.parametrize("kind", ["folder", "memory"])
def test_a_worker_with_other_artifacts_is_told_before_it_takes_an_action(tmp_path, kind):
    if kind == "memory":
        pytest.importorskip("fsspec")
    wrong = {"folder": tmp_path / "wrong", "memory": f"memory://{tmp_path.name}"}[kind]
    right = {"folder": tmp_path / "right", "memory": f"memory://right-{tmp_path.name}"}[kind]
    study = opened(Slow(), tmp_path, artifacts=right)
    for given in (wrong, None):
        worker = elsewhere(tmp_path, given)
        with pytest.raises(StudyMismatch, match=rf"are not in .*was .*{tmp_path.name}") as caught:
            worker.run(progress=False)
        assert "--artifacts" in str(caught.value)
        with pytest.raises(StudyMismatch, match="one place"):
            opened(Slow(), tmp_path, artifacts=given)
    assert [event.kind for event in study.events()] == ["opened"]
    elsewhere(tmp_path, right).run(progress=False)
    assert elsewhere(tmp_path, wrong).run(progress=False).study.is_finished  # nothing to be kept


def test_artifacts_are_the_same_wherever_they_are_found(tmp_path):
    """A folder that machines share has other names on each, and a study may be moved."""
    opened(Slow(), tmp_path, artifacts=tmp_path / "here")
    (tmp_path / "here").rename(tmp_path / "there")
    assert elsewhere(tmp_path, tmp_path / "there").run(progress=False).study.is_finished


def test_a_study_of_before_is_known_by_its_first_policy(tmp_path, monkeypatch):
    monkeypatch.setattr("mbtl.study.steps.create.marked", lambda store, uid: {})
    study = opened(Slow(), tmp_path)
    assert not study.state.kept

    class Stops(StepCallback):
        def on_trained(self, study, training):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study.run(progress=False, callbacks=[Stops()])
    with pytest.raises(StudyMismatch, match="give the study's own --artifacts"):
        elsewhere(tmp_path, tmp_path / "wrong").run(progress=False)
    assert elsewhere(tmp_path, None).run(progress=False).study.is_finished


def test_what_follows_from_an_older_state_is_not_recorded(tmp_path):
    study, other = opened(Slow(), tmp_path), opened(Slow(), tmp_path)
    seq = study.state.seq
    other.extend(160_000)
    with pytest.raises(Conflict):
        study.append("stopped", {"reason": "nothing"}, after=seq)
    study.extend(170_000)  # this holds in any case
    assert other.refresh().the_spec.budget == 170_000


def test_to_wait_for_nothing_is_refused():
    class Idle:
        name = "idle"

        def decide(self, problem, trail, rng):
            return Wait()

    with pytest.raises(InvalidInput, match="may wait only while something is under way"):
        opened(Slow(), strategy=Idle()).run(progress=False)


def test_a_log_of_one_process_that_says_no_decisions_is_read():
    """As those were before there were several workers."""

    class Script:
        name = "script"

        def decide(self, problem, trail, rng):
            done = len(trail.policies) + len(trail.trainings)
            return [Start(5, 1), Evaluate(Policy(0, 1), (5,)), Stop()][done]

    study = opened(Slow(), strategy=Script())
    study.run(progress=False, report=False)
    state = mbtl.study.steps.state.StepState()
    for event in study.events():
        data = {k: v for k, v in event.data.items() if k not in ("decision", "token")}
        state.apply(mbtl.study.events.Event(event.kind, data, event.arrays, event.seq))
    assert state.spent == study.state.spent
    assert json.dumps(state.dead) == "[]"
    assert Extend(0, 2) not in [held.work for held in state.under_way.values()]
