"""Studies that are paid in steps: every step is charged, nothing is lost, and limits are said."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from step_problem import SPACE, WHOLE, Slow, opened, outcome
from warm_strategy import NAMED, Warm

import mbtl
from mbtl.actions import Evaluate, Extend, FixedLength, Policy, Start, Stop
from mbtl.errors import (
    InvalidInput,
    StudyError,
    StudyMismatch,
    TrainingFailed,
    UnknownName,
)
from mbtl.study.steps.create import lengths_of

PROGRAM = Path(__file__).parent / "step_problem.py"


class Script:
    """A strategy that does what it is told."""

    name = "script"

    def __init__(self, *actions):
        self.actions = actions

    def decide(self, problem, trail, rng):
        done = len(trail.policies) + len(trail.trainings)
        return self.actions[done] if done < len(self.actions) else Stop()


@pytest.mark.parametrize("strategy", ["pilot", "fixed", "halving", "asha", "committee", Warm()])
def test_what_is_charged_is_what_ran(strategy):
    trainer = Slow()
    study = opened(trainer, strategy=strategy)
    result = study.run(progress=False, report=False)
    prices = result.summary.prices
    assert prices["training"] + prices["extension"] == trainer.ran["steps"]
    assert prices["checks"] == trainer.ran["checks"]
    assert prices["evaluation"] == trainer.ran["evaluation"]
    assert result.summary.spent == sum(trainer.ran.values()) <= 150_000
    assert result.value > 0.8
    assert len(study.portfolio()) == len(study.state.policies) > 1


def test_fresh_episodes_are_reported_and_not_charged():
    trainer = Slow()
    result = opened(trainer).run(progress=False)
    charged, report = result.summary.spent, result.summary.fresh_steps
    assert charged + report == sum(trainer.ran.values())
    assert result.value == result.summary.fresh_value
    assert 0 < result.summary.fresh_margin < 0.2


def test_all_weights_that_a_training_passed_are_at_hand():
    """The pilot looks back from the end of its first training."""
    study = opened(Slow())
    study.run(progress=False)
    pilot = [p.length for p in study.state.policies if p.training == 0]
    assert len(pilot) > 2
    assert pilot[0] == len(study.spec.lengths) - 1
    first = study.state.trainings[0]
    assert sorted(first.marks) == list(range(len(first.marks)))
    assert first.ended
    assert first.steps < WHOLE


@pytest.mark.parametrize("strategy", ["pilot", "committee", "warm"])
def test_killed_at_any_moment_a_study_ends_as_if_undisturbed(tmp_path, strategy):
    calm = opened(Slow(), strategy=NAMED.get(strategy, strategy))
    calm.run(progress=False)
    kills, work = 0, 45  # the longest piece has 32 units of work
    while True:
        run = subprocess.run(
            [sys.executable, PROGRAM, tmp_path, str(work), strategy],
            capture_output=True,
            text=True,
        )
        if run.returncode == 0:
            break
        assert run.returncode == -signal.SIGKILL, run.stderr
        kills, work = kills + 1, work + 10
    assert kills > 1
    assert json.loads(run.stdout) == json.loads(json.dumps(outcome(calm)))


def test_an_interrupted_training_goes_on_from_its_last_mark(tmp_path):
    class Interrupt(KeyboardInterrupt):
        pass

    class Stops(mbtl.study.steps.callbacks.StepCallback):
        def on_trained(self, study, training):
            if len(study.state.trainings[training].marks) == 2:
                raise Interrupt

    study = opened(Slow(), tmp_path)
    with pytest.raises(Interrupt):
        study.run(progress=False, callbacks=[Stops()])
    trainer = Slow()
    again = opened(trainer, tmp_path)
    again.run(progress=False, report=False)
    assert trainer.ran["steps"] == again.state.trainings[0].steps - 16_000 + sum(
        t.steps for t in again.state.trainings[1:]
    )
    undisturbed = opened(Slow())
    undisturbed.run(progress=False)
    again.run(progress=False)
    assert outcome(again) == outcome(undisturbed)


def test_a_finished_study_does_nothing_again_and_a_larger_budget_extends_it(tmp_path):
    opened(Slow(), tmp_path).run(progress=False)
    trainer = Slow()
    study = opened(trainer, tmp_path)
    assert study.is_finished
    study.run(progress=False)
    assert not any(trainer.ran.values())
    more = opened(trainer, tmp_path, budget=250_000)
    assert not more.is_finished
    spent = more.state.spent
    more.run(progress=False)
    assert spent < more.state.spent <= 250_000


def test_the_last_steps_go_as_far_as_they_reach_and_are_evaluated():
    study = opened(Slow(), budget=30_000, strategy=FixedLength(name="whole"))
    summary = study.run(progress=False).summary
    (training,) = summary.trainings
    assert training.steps == 16_000  # the next mark, 32,000, costs more than there is
    assert training.state == "halted"
    assert summary.policies == 1
    assert summary.finished == "the budget of 30,000 steps is spent"


def test_a_strategy_may_extend_evaluate_in_parts_and_stop():
    study = opened(Slow(), strategy=Script(Start(5, 0), Evaluate(Policy(0, 0), (5, 6))))
    study.run(progress=False)
    assert study.state.stopped == "the strategy says that nothing more is worth its steps"
    assert np.isfinite(study.state.returns[0]).sum() == 2
    assert study.summary().trainings[0].state == "stopped"

    class Goes(Script):
        def decide(self, problem, trail, rng):
            if trail.trainings and trail.trainings[0].length == 0 and trail.policies:
                return Extend(0, 1)
            if trail.trainings and trail.unevaluated:
                return Evaluate(trail.unevaluated, (5,))
            return super().decide(problem, trail, rng)

    study = opened(Slow(), strategy=Goes(Start(5, 0)))
    prices = study.run(progress=False).summary.prices
    assert prices["training"] == prices["extension"] == 8_000


def test_a_failed_training_is_not_begun_again_and_its_steps_are_charged():
    trainer = Slow(fails_at=0.5)  # the middle, where every strategy begins
    study = opened(trainer, strategy="fixed", budget=250_000)
    study.run(progress=False)
    assert all(t.source != 5 for t in study.state.trainings)
    assert study.state.prices.failed == 4_000  # as far as it had told
    assert study.value > 0.8


def test_many_failures_end_the_run():
    class Never(Slow):
        def train(self, *given, **named):
            raise RuntimeError("no licence")

    with pytest.raises(TrainingFailed, match=r"3 trainings .* in a row failed.*licence"):
        opened(Never()).run(progress=False)


# ---- functions -----------------------------------------------------------------------------------


def evaluate(policy, contexts, seeds):
    return [policy[1] - abs(c["x"] - policy[0]) for c in contexts]


def load(folder):
    return np.load(folder / "p.npy")


def save(policy, folder):
    np.save(folder / "p.npy", policy)


def test_a_plain_function_trains_at_its_fixed_length():
    study = mbtl.create_study(
        SPACE, cost="steps", budget=40_000, lengths=[10_000], horizon=10, strategy="fixed",
        bounds=(0.0, 1.0),
    )  # fmt: skip
    study.run(lambda context, seed: (context["x"], 1.0), evaluate, progress=False)
    assert [t.steps for t in study.state.trainings] == [10_000] * 3
    assert study.state.prices.evaluation % 10 == 0  # the longest that an episode can be


def test_a_function_that_takes_a_length_goes_on_from_its_policy(tmp_path):
    calls = []

    def train(contexts, seed, *, start=None, length=None):
        calls.append((length, start is not None))
        done = 0.0 if start is None else start[1]
        return np.array([contexts[0]["x"], done + length / 2])

    study = mbtl.create_study(
        SPACE, cost="steps", budget=60_000, lengths=[10_000, 20_000, 40_000], horizon=10,
        bounds=(0.0, 1.0), storage=tmp_path / "study.db",
    )  # fmt: skip
    study.run(train, evaluate, save=save, load=load, progress=False)
    assert calls[:3] == [(0.25, False), (0.25, True), (0.5, True)]
    first = study.portfolio(None).policy_folders[0]
    assert load(first)[1] == pytest.approx(0.5)


def test_lengths_of_a_function_that_knows_none_are_refused():
    study = mbtl.create_study(
        SPACE, cost="steps", budget=40_000, lengths=[5_000, 10_000], horizon=10
    )
    with pytest.raises(
        InvalidInput,
        match=r"cannot train for a length .* train\(context, seed\); give train\(contexts",
    ):
        study.run(lambda context, seed: 0, evaluate, progress=False)


# ---- what is refused -----------------------------------------------------------------------------


def test_settings_that_mean_nothing_are_refused():
    with pytest.raises(UnknownName, match=r"no strategy is called 'pilott'. Did you mean 'pilot'"):
        opened(Slow(), strategy="pilott")
    with pytest.raises(InvalidInput, match="pays for one short training and its evaluation"):
        opened(Slow(), budget=8_100)
    with pytest.raises(InvalidInput, match="give horizon="):
        opened(Slow(), horizon=None)
    with pytest.raises(InvalidInput, match="how long a training is must be known"):
        mbtl.create_study(SPACE, cost="steps", budget=10_000, horizon=10)
    with pytest.raises(InvalidInput, match="lengths are numbers of steps >= 1 that rise"):
        opened(Slow(), lengths=[5, 5])
    with pytest.raises(InvalidInput, match="a strategy decides"):
        mbtl.create_study(SPACE, cost="steps", budget=10_000, horizon=10, selector="mbtl")
    with pytest.raises(InvalidInput, match="strategy belongs to a study that is paid in steps"):
        mbtl.create_study(SPACE, budget=3, strategy="pilot")
    with pytest.raises(InvalidInput, match="counts 'trainings' or 'steps', got cost='money'"):
        mbtl.create_study(SPACE, budget=3, cost="money")


def test_the_two_kinds_of_studies_are_told_apart(tmp_path):
    opened(Slow(), tmp_path)
    with pytest.raises(StudyError, match=r"paid in steps.*open it with mbtl.StepStudy.load"):
        mbtl.load_study(tmp_path)
    mbtl.create_study(SPACE, budget=3, storage=tmp_path / "other.db")
    with pytest.raises(StudyError, match=r"paid in trainings.*open it with mbtl.load_study"):
        mbtl.StepStudy.load(tmp_path / "other.db")
    with pytest.raises(StudyMismatch, match="is paid in trainings; start another one"):
        mbtl.create_study(
            SPACE, cost="steps", budget=10_000, lengths=[1_000], horizon=10,
            storage=tmp_path / "other.db", load_if_exists=True,
        )  # fmt: skip
    with pytest.raises(StudyMismatch, match="horizon was 20, got 25"):
        opened(Slow(), tmp_path, horizon=25)


def test_lengths_halve_down_to_the_shortest_that_says_something():
    assert lengths_of(1_000_000)[0] == 15_625
    assert lengths_of(5_000_192)[::9] == (9_766, 5_000_192)
    assert lengths_of(5_000) == (5_000,)


@pytest.mark.parametrize("budget", [30_000, 45_000])
def test_a_pilot_that_the_budget_halted_goes_on_when_that_is_raised(budget):
    study = opened(Slow(), budget=budget)
    study.run(progress=False)
    (pilot,) = study.state.trainings
    assert pilot.halted
    assert 0 < pilot.length < len(study.spec.lengths) - 1
    study.extend(150_000)
    study.run(progress=False)
    assert study.state.trainings[0].length == len(study.spec.lengths) - 1
    assert len(study.state.trainings) > 1
