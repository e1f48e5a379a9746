"""Failures cost nothing twice: found early, kept with their cause, done again from where it broke.

`Bench` trains nothing: a policy is the context's number, worth 1 there and less farther away.
"""

from dataclasses import replace

import numpy as np
import pytest
from line_problem import line

import mbtl
from flat import created, ran
from mbtl.errors import StorageError, StudyError, TrainingFailed
from mbtl.seeds import training_seed
from mbtl.study import Callback, Failures
from mbtl.trainers import Trained, Trainer

pytestmark = pytest.mark.filterwarnings("ignore::mbtl.errors.UnsavedPolicies")
N = 9
SPACE = line(N)


class Bench(Trainer):
    """A trainer that counts, and breaks where it is told to."""

    recipe = {"trainer": "bench"}  # noqa: RUF012

    def __init__(self, train=None, evaluate=None, load=None, save=None, saves=True):
        self.trained, self.evaluated = [], []
        self.breaks = {"train": train, "evaluate": evaluate, "load": load, "save": save}
        self.saves = saves

    def _break(self, name, *facts):
        return None if self.breaks[name] is None else self.breaks[name](*facts)

    def train(self, contexts, seed, **asked):
        self.trained.append(contexts[0]["x"])
        self._break("train", len(self.trained))
        return Trained(contexts[0]["x"])

    def evaluate(self, policy, contexts, seeds):
        self.evaluated.append((policy, len(contexts)))
        broken = self._break("evaluate", len(self.trained), contexts)
        return [1 - abs(policy - c["x"]) for c in contexts] if broken is None else broken

    def save(self, policy, folder):
        self._break("save", policy)
        if self.saves:
            (folder / "policy.txt").write_text(str(policy))
        return self.saves

    def load(self, folder):
        self._break("load", folder)
        return float((folder / "policy.txt").read_text())


class Rehearsing(Bench):
    def untrained(self, context):
        return 0.0


def study_in(path, **settings):
    settings = {"budget": 5, "bounds": (0.0, 1.0), "strategy": "random", **settings}
    return created(SPACE, storage=path and path / "study.db", load_if_exists=True, **settings)


def fails(when, error=RuntimeError):
    def broken(count, *_):
        if when(count):
            raise error("licence expired")

    return broken


def of_the_second(trainer, broken):
    """An evaluation of the second policy, and of no other one, is `broken(contexts)`."""
    lost = []

    def evaluate(count, contexts):
        policy = trainer.evaluated[-1][0]
        if count == 2 and not lost:
            lost.append(policy)
        return broken(contexts) if lost == [policy] else None

    return evaluate


def wrong_shape(_, contexts):
    return [0.0] * (len(contexts) + 1)


@pytest.mark.parametrize(
    "broken", [{"evaluate": wrong_shape}, {"save": lambda p: 1 / 0}, {"load": lambda f: 1 / 0}]
)
def test_a_trainer_that_can_rehearse_trains_nothing_before_all_of_it_works(tmp_path, broken):
    trainer, study = Rehearsing(**broken), study_in(tmp_path)
    with pytest.raises((TrainingFailed, StorageError), match=r"shape|ZeroDivisionError"):
        study.run(trainer=trainer)
    assert (trainer.trained, study.state.picks) == ([], [])
    trainer.breaks = dict.fromkeys(trainer.breaks)
    study.run(trainer=trainer)
    assert len(study.state.rows) == 5


def test_a_rehearsal_is_short_and_can_be_left_out():
    trainer = Rehearsing()
    study_in(None, budget=1).run(trainer=trainer, report=False)
    assert trainer.evaluated == [(0.0, 2), (trainer.trained[0], N)]
    trainer = Rehearsing()
    ran(study_in(None, budget=1), trainer=trainer, report=False, rehearse=False)
    assert trainer.evaluated == [(trainer.trained[0], N)]


@pytest.mark.parametrize(
    ("saves", "then"), [(True, "kept and only evaluated"), (False, "memory of this process alone")]
)
def test_a_wrong_shape_costs_one_training_at_most_and_its_policy_is_kept(tmp_path, saves, then):
    trainer, study = Bench(evaluate=wrong_shape, saves=saves), study_in(tmp_path)
    with pytest.raises(TrainingFailed, match=rf"the policy is trained.*{then}") as raised:
        study.run(trainer=trainer)
    assert isinstance(raised.value.__cause__, TrainingFailed)  # where it came from
    assert trainer.evaluated == [(trainer.trained[0], 2)]
    assert len(study.state.picks) == 1
    assert not study.state.failures
    assert "checked_returns" in study.state.deferred[0].traceback
    trainer.breaks["evaluate"] = None
    again = study_in(tmp_path) if saves else study  # also in another process, where it was saved
    again.run(trainer=trainer)
    assert len(again.state.rows) == len(trainer.trained) == 5
    assert not again.state.deferred


def test_a_licence_that_expires_after_the_first_training_ends_the_run_after_three(tmp_path):
    """It used to give 1 row and 14 failures, and a normal return."""
    trainer = Bench(train=fails(lambda count: count > 1))
    study = study_in(tmp_path)
    with pytest.raises(TrainingFailed, match="3 failures in a row"):
        study.run(trainer=trainer)
    assert (len(study.state.rows), len(study.state.failures)) == (1, 3)
    trainer.breaks["train"] = None
    study = ran(study_in(tmp_path), trainer=trainer, retry_failed=True).study
    assert (len(study.state.rows), len(study.state.failures)) == (5, 0)
    assert len(study.state.picks) == 5  # what failed spent no budget twice


def test_failures_with_successes_between_do_not_end_the_run(tmp_path):
    trainer = Bench(train=fails(lambda count: count % 3 == 0))
    study = study_in(tmp_path, budget=8).run(trainer=trainer).study
    assert (len(study.state.rows), len(study.state.failures)) == (6, 2)
    trainer = Bench(train=fails(lambda count: count % 3 == 0))
    with pytest.raises(TrainingFailed, match="1 failure in a row"):
        ran(study_in(None, budget=8), trainer=trainer, stop_after_failures=1)
    assert len(trainer.trained) == 3


def test_a_failed_evaluation_spends_nothing_and_is_done_again_at_the_end(tmp_path):
    trainer = Bench(evaluate=lambda count, _: wrong_shape(0, []) if count == 2 else None)
    heard = []

    class Ear(Callback):
        def on_failed(self, study, pick, reason):
            heard.append((pick.number, reason))

    study = study_in(tmp_path).run(trainer=trainer, callbacks=[Ear()]).study
    assert (len(study.state.rows), len(study.state.failures)) == (5, 0)
    assert len(trainer.trained) == 5
    assert study.state.rows[-1].pick == 1
    assert heard[0][0] == 1
    assert "the policy is trained, its evaluation failed" in heard[0][1]


@pytest.mark.parametrize("saves", [True, False])
def test_an_evaluation_that_fails_twice_waits_for_the_next_run(tmp_path, saves):
    trainer = Bench(saves=saves)
    trainer.breaks["evaluate"] = of_the_second(trainer, fails(lambda contexts: True))
    study = study_in(tmp_path).run(trainer=trainer).study
    assert len(study.state.rows) == 4
    assert list(study.state.deferred) == [1]
    assert not study.is_finished
    trainer.breaks["evaluate"] = None
    study.run(trainer=trainer)
    assert study.is_finished
    assert len(trainer.trained) == len(study.state.rows) == 5
    assert not study.untold


@pytest.mark.parametrize("saves", [True, False])
def test_a_policy_that_no_evaluation_survives_is_trained_again_on_request(tmp_path, saves):
    """Another seed gives another policy, and until somebody asks the first one is kept."""
    trainer = Bench(saves=saves)
    nothing = of_the_second(trainer, lambda contexts: np.full(len(contexts), np.nan))
    trainer.breaks["evaluate"] = nothing
    study = study_in(tmp_path).run(trainer=trainer, report=False).study
    for _ in range(2):  # nothing is trained, and nothing is over
        assert list(study.state.deferred) == [1]
        assert len(trainer.trained) == 5
        study.run(trainer=trainer, report=False)
    trainer.breaks["evaluate"] = None
    before = study.state.picks[1]
    study.run(trainer=trainer, failures=Failures(retry_failed=True), report=False)
    assert trainer.trained[5:] == [SPACE.context(before.source)["x"]]
    assert (study.state.picks[1].retries, before.retries) == (1, 0)
    assert study.is_finished
    assert len(study.state.rows) == 5
    assert not study.state.deferred


def test_what_is_tried_again_is_not_answered_by_whoever_evaluates_the_old_policy(tmp_path):
    study = study_in(tmp_path)
    pick = study.ask(lease=600.0)
    study.defer(pick, "no display", steps=70.0)
    other = mbtl.load_study(tmp_path)
    other.retry(pick.number)
    assert study.tell(pick, np.ones(N)) is False
    assert not study.refresh().rows
    assert study.state.lost_steps == 70.0
    again = other.ask()
    assert (again.number, again.seed) == (pick.number, other.state.seed_of(other.state.picks[0]))
    assert again.seed != pick.seed
    assert other.tell(again, np.ones(N))


def test_a_policy_that_cannot_be_read_back_is_not_trained_again(tmp_path):
    stops = [KeyboardInterrupt]

    def interrupted(count, contexts):
        if count == 2 and stops:
            raise stops.pop()

    trainer = Bench(evaluate=interrupted)
    with pytest.raises(KeyboardInterrupt):
        study_in(tmp_path).run(trainer=trainer)
    trainer.breaks["load"] = fails(lambda folder: True)
    study = study_in(tmp_path).run(trainer=trainer, report=False).study
    assert list(study.state.deferred) == [1]
    assert "its loading failed with RuntimeError" in study.state.deferred[1].reason
    trainer.breaks["load"] = None
    study.run(trainer=trainer)
    assert len(trainer.trained) == len(study.state.rows) == 5


def test_a_policy_that_could_not_be_saved_is_kept_for_the_next_run_of_the_process(tmp_path):
    trainer, study = Bench(save=lambda policy: 1 / 0), study_in(tmp_path)
    with pytest.raises(StorageError, match=r"save raised ZeroDivisionError.*of this process alone"):
        study.run(trainer=trainer)
    trainer.breaks["save"] = None
    study.run(trainer=trainer)
    assert len(trainer.trained) == 5
    assert all(row.policy for row in study.state.rows)


def test_only_a_failed_pick_is_opened_again_once():
    study = study_in(None)
    pick, other = study.ask(2)
    study.fail(pick, "diverged")
    with pytest.raises(StudyError, match="pick 2, which did not fail"):
        study.retry(other)
    study.retry(0)
    assert not study.state.failures
    again = study.ask()
    assert again == replace(pick, seed=training_seed(0, 0, pick.source, 1))
    with pytest.raises(StudyError, match="pick 1, which did not fail"):
        study.retry(pick)
    study.fail(again, "diverged again")
    study.tell(pick.source, np.ones(N))
    with pytest.raises(StudyError, match="was told since"):
        study.retry(pick)
