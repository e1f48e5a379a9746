"""Studies that are paid in steps, with recipes that count episodes: charged is what was played."""

import json
from dataclasses import dataclass, field

import numpy as np
import pytest
from step_problem import OfNumbers, outcome

import mbtl
from mbtl.actions import Evaluate, Extend, Policy, Start, Stop
from mbtl.errors import InvalidInput
from mbtl.study.steps.callbacks import StepCallback
from mbtl.study.steps.prices import share_of
from mbtl.trainer import Progress, Trained

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 11})
HORIZON, EPISODES = 1_000, 32


@dataclass
class Episodic(OfNumbers):
    """Its episodes are as long as the horizon at x = 0, and a tenth of that at x = 1."""

    episodes: int | None = EPISODES
    eval_episodes: int = 2
    fails: bool = False
    asked: list = field(default_factory=list)
    ran: int = 0
    policy_format = "custom"
    takes = frozenset({"start", "length", "state"})
    counts = "episodes"

    @property
    def whole(self):
        return self.episodes

    def train(self, contexts, seed, *, length=1.0, state=None, on_progress=None, **given):
        (context,), steps = contexts, round(length * self.episodes)
        self.asked.append(steps)
        done = json.loads(state.read_text()) if state is not None and state.exists() else 0
        each = length_at(context)
        while done < steps:
            done += 1
            self.ran += each
            if on_progress is not None:
                on_progress(Progress(done * each, self.episodes * each))
            if self.fails and done == 20:
                raise RuntimeError("the simulator fell over")
        if state is not None:
            state.write_text(json.dumps(done))
        return Trained(np.array([context["x"], done / self.episodes]), done * each)

    def evaluate_steps(self, policy, contexts, seeds):
        x, skill = policy
        returns = [[skill - abs(c["x"] - x)] * self.eval_episodes for c in contexts]
        steps = [[length_at(c)] * self.eval_episodes for c in contexts]
        return np.array(returns), np.array(steps)


class Script:
    """Does what it is told, one action after another."""

    name = "script"

    def __init__(self, *actions):
        self.left = list(actions)

    def decide(self, problem, trail, rng):
        return self.left.pop(0) if self.left else Stop()


def length_at(context):
    return round(HORIZON * (1.0 - 0.9 * context["x"]))


def opened(trainer, folder=None, budget=250_000, **settings):
    return mbtl.create_study(
        SPACE, cost="steps", budget=budget, trainer=trainer, horizon=HORIZON, episodes=2,
        bounds=(0.0, 1.0), storage=None if folder is None else folder / "study.db",
        load_if_exists=True, **settings,
    )  # fmt: skip


@pytest.mark.parametrize("strategy", ["pilot", "fixed", "halving", "asha"])
def test_charged_is_what_was_played(strategy):
    trainer = Episodic()
    study = opened(trainer, strategy=strategy)
    assert study.spec.lengths == (8_000, 16_000, 32_000)
    study.run(progress=False, report=False)
    prices = study.state.prices
    assert prices.training + prices.extension == trainer.ran
    assert set(trainer.asked) <= {8, 16, 32}
    for course in study.state.trainings:
        each = length_at(study.space.context(course.source))
        assert {mark: m.steps for mark, m in course.marks.items()} == {
            mark: episodes * each
            for mark, episodes in enumerate((8, 16, 32))
            if mark in course.marks
        }
    assert 230_000 < study.state.spent <= 250_000
    assert study.value > 0.8


def test_the_pilot_looks_back_at_all_its_marks_wherever_it_is():
    """In steps a training on short episodes is behind its first mark even at its end."""
    study = opened(Episodic(), strategy="pilot")
    study.run(progress=False, report=False)
    source = study.state.trainings[0].source
    assert length_at(study.space.context(source)) * EPISODES < 3 * 8_000
    assert {p.length for p in study.state.policies if p.training == 0} == {0, 1, 2}


def test_a_training_goes_on_at_the_price_of_its_own_episodes():
    """At the price of the longest ones, 32,000 steps, there is not enough left for it."""
    shortest, last = 10, (10,)
    script = Script(Start(shortest, 1), Evaluate(Policy(0, 1), last), Extend(0, 2))
    study = opened(Episodic(), budget=20_000, strategy=script, lengths=[1_000, 16_000, 32_000])
    study.run(progress=False, report=False)
    (course,) = study.state.trainings
    assert share_of(study.state, 0) == pytest.approx(0.1)
    assert course.steps == 3_200
    assert not course.halted


def test_an_interrupted_study_of_episodes_goes_on_as_if_it_had_not_been(tmp_path):
    calm = opened(Episodic())
    calm.run(progress=False)

    class Stops(StepCallback):
        left = 4

        def on_trained(self, study, training):
            self.left -= 1
            if not self.left:
                raise KeyboardInterrupt

    first, second = Episodic(), Episodic()
    with pytest.raises(KeyboardInterrupt):
        opened(first, tmp_path).run(progress=False, callbacks=[Stops()])
    study = opened(second, tmp_path)
    study.run(progress=False)
    assert outcome(study) == outcome(calm)
    assert first.ran + second.ran == sum(t.steps for t in study.state.trainings)


def test_a_training_that_fails_is_charged_what_it_played():
    study = opened(Episodic(fails=True), strategy=Script(Start(5, 2)))
    study.run(progress=False, report=False)
    (course,) = study.state.trainings
    assert course.steps == 16 * 550
    assert study.state.prices.failed == 4 * 550


def test_a_trainer_that_says_no_length_is_refused():
    trainer = Episodic(episodes=None)
    with pytest.raises(InvalidInput, match="Episodic does not say"):
        opened(trainer)
