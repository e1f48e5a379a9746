"""One policy for several contexts as a part of a study that is paid in steps."""

import numpy as np
import pytest
from step_problem import HORIZON, SPACE, WHOLE, Slow, opened

import mbtl
from mbtl.actions import Committee, Evaluate, Extend, FixedLength, Policy, Start, StartOn, Stop
from mbtl.errors import InvalidInput
from mbtl.study.steps.callbacks import PrintSteps, StepCallback
from mbtl.trainer import Trained

EVERY = tuple(range(SPACE.n))


class Script:
    """A strategy that does what it is told."""

    name = "script"

    def __init__(self, *actions):
        self.actions = actions

    def decide(self, problem, trail, rng):
        waiting = trail.unevaluated
        if waiting is not None:
            return Evaluate(waiting, EVERY)
        done = sum(p.training >= 0 for p in trail.policies)
        return self.actions[done] if done < len(self.actions) else Stop()


def test_a_policy_of_a_set_is_a_member_of_the_portfolio_like_any_other(tmp_path):
    study = opened(Slow(), tmp_path, strategy=Script(Start(5, 3), StartOn(EVERY, 3)))
    study.run(progress=False)
    portfolio = study.portfolio()
    assert portfolio.sets == {1: EVERY}
    assert (portfolio.assignment == 1).sum() == SPACE.n - 1  # the specialist is better at home
    assert (
        "Policy 2, trained on all contexts, returned" in portfolio.explain({"x": 0.3}).explanation
    )
    one = study.summary().trainings[1]
    assert (one.trained_on, one.serves, one.steps) == ("all contexts", SPACE.n - 1, 16_000)
    portfolio.save(tmp_path / "portfolio")
    again = mbtl.load_portfolio(tmp_path / "portfolio", Slow().load)
    assert again.sets == portfolio.sets
    assert "trained on all contexts" in again.explain({"x": 0.35}).explanation


def test_some_contexts_are_a_set_too_and_are_drawn_at_their_middle():
    study = opened(Slow(), strategy=Script(StartOn((2, 3, 4, 8), 2)))
    study.run(progress=False)
    assert study.state.trainings[0].source == 4
    assert study.summary().trainings[0].trained_on == "4 contexts"
    assert "trained on 4 contexts" in study.portfolio().explain({"x": 0.3}).explanation


def test_it_goes_to_its_first_mark_at_once_and_can_be_extended_from_mark_to_mark():
    given = []

    class Tells(Slow):
        def on_several(self, contexts, seed, steps, marks, **more):
            given.append((steps, tuple(marks), seed))
            return super().on_several(contexts, seed, steps, marks, **more)

    trainer = Tells()
    script = Script(StartOn(EVERY, 1), Extend(0, 3), StartOn(EVERY, 0))
    study = opened(trainer, strategy=script)
    study.run(progress=False, report=False)
    marks = (2_000, 4_000, 8_000, 16_000, 32_000, 64_000, 128_000)
    assert study.spec.lengths_on_all == marks
    assert [(steps, later) for steps, later, _ in given] == [
        (4_000, marks[1:]), (8_000, marks[1:]), (16_000, marks[1:]), (2_000, marks),
    ]  # fmt: skip
    assert given[0][2] == given[1][2] != given[3][2]  # another training has another seed
    prices = study.summary().prices
    assert prices["training"] == 4_000 + 2_000
    assert prices["extension"] == 12_000
    assert study.state.policies[:2] == [Policy(0, 1), Policy(0, 3)]
    assert sum(prices.values()) == sum(trainer.ran.values())


def test_a_recipe_of_episodes_is_given_episodes_and_reserves_what_they_lasted_before():
    given = []

    class Played(Slow):
        whole, counts = WHOLE // HORIZON, "episodes"

        def on_several(self, contexts, seed, steps, marks, **more):
            given.append((steps, tuple(marks)))
            return Trained(np.array([np.nan, self.level]), 2 * steps)  # a tenth of the longest

    script = Script(StartOn(EVERY, 1), StartOn(EVERY, 3))
    study = opened(Played(), strategy=script, budget=17_000)
    study.run(progress=False, report=False)
    assert study.spec.lengths_on_all == (2_000, 4_000, 8_000, 16_000)
    assert given == [(200, (200, 400, 800)), (800, (800,))]
    # at its mark, 16,000 steps, the second would not have been paid for
    assert [t.steps for t in study.state.trainings] == [400, 1_600]
    assert study.summary().prices["training"] == 2_000


@pytest.mark.parametrize(
    ("level", "said"),
    [(0.99, "one policy for all is enough here"), (0.1, "specialists are ahead here")],
)
def test_a_committee_finds_out_who_is_ahead_and_says_so(level, said, tmp_path):
    strategy = Committee(FixedLength("mbtl"))
    study = opened(Slow(level=level), tmp_path, budget=600_000, strategy=strategy)
    result = study.run(progress=False)
    assert said in result.summary.verdict
    if level > 0.5:
        assert said in result.summary.finished
        assert result.summary.spent < 600_000
    again = opened(Slow(level=level), tmp_path, budget=600_000, strategy=strategy)
    assert again.summary() == result.summary


def test_a_committee_lives_with_a_set_that_cannot_be_trained():
    class Never(Slow):
        def on_several(self, *given, **named):
            raise RuntimeError("too many contexts")

    study = opened(Never(), strategy="committee", budget=200_000)
    study.run(progress=False)
    assert study.state.dead_on_sets
    assert not study.state.dead
    assert study.value > 0.8


def test_what_is_shown_names_all_contexts():
    lines, running = [], []

    class Looks(StepCallback):
        def on_training(self, study, training, source, to):
            running.append((source, to))

    study = opened(Slow(), strategy=Script(StartOn(EVERY, 2)))
    study.run(progress=False, callbacks=[PrintSteps(lines.append), Looks()])
    assert any("training 1 (all contexts): 8K steps" in line for line in lines)
    assert running == [(5, 8_000)]


# ---- who can do it -------------------------------------------------------------------------------


def evaluate(policy, contexts, seeds):
    return [policy[1] - (0.0 if np.isnan(policy[0]) else abs(c["x"] - policy[0])) for c in contexts]


def train(context, seed, *, start=None, length=None):
    return np.array([context["x"], (0.0 if start is None else start[1]) + length / 2])


def load(folder):
    return np.load(folder / "p.npy")


def save(policy, folder):
    np.save(folder / "p.npy", policy)


def plain():
    return mbtl.create_study(
        SPACE, cost="steps", budget=200_000, lengths=[10_000, 20_000, 40_000], horizon=10,
        bounds=(0.0, 1.0), strategy="committee",
    )  # fmt: skip


def test_a_plain_function_that_takes_contexts_trains_on_a_set():
    calls = []

    def on_any(contexts, seed, *, start=None, length=None):
        if len(contexts) == 1:
            return train(contexts[0], seed, start=start, length=length)
        calls.append((len(contexts), length))
        return np.array([np.nan, 1.0])

    study = plain()
    study.run(on_any, evaluate, save=save, load=load, progress=False)
    assert calls[:2] == [(SPACE.n, 1 / 32), (SPACE.n, 1 / 16)]
    assert study.value == pytest.approx(1.0)


def test_a_trainer_of_single_contexts_is_refused_before_anything_is_spent():
    study = plain()
    with pytest.raises(
        InvalidInput,
        match=r"committee.*several contexts: its function is train\(context, seed, start",
    ):
        study.run(train, evaluate, save=save, load=load, progress=False)
    assert study.state.spent == 0
