"""Studies whose trainings begin with the weights of others: carried out, kept, refused."""

import json
import shutil

import numpy as np
import pytest
from step_problem import SPACE, Slow, opened, outcome
from warm_strategy import Warm

import mbtl
from mbtl.actions import Evaluate, Extend, Policy, Start, Stop
from mbtl.benchmark.steps import StepWorld
from mbtl.errors import InvalidInput

BEGUN = Start(8, 0, Policy(0, 2))


class Script:
    """A strategy that does what it is told."""

    name = "script"
    starts_warm = True

    def __init__(self, *actions):
        self.actions = actions

    def decide(self, problem, trail, rng):
        """As many as are done; a mark that is passed counts for an extension."""
        done = len(trail.policies) + sum(1 + (t.start is not None and t.length > 0)
                                         for t in trail.trainings)  # fmt: skip
        return self.actions[done] if done < len(self.actions) else Stop()


STORY = Script(
    Start(5, 2), Evaluate(Policy(0, 2), (5,)), BEGUN, Evaluate(Policy(1, 0), (8,)), Extend(1, 2),
    Evaluate(Policy(1, 2), (8, 9)),
)  # fmt: skip


def test_a_training_begins_with_the_weights_that_it_is_given():
    trainer = Slow()
    study = opened(trainer, strategy=STORY)
    study.run(progress=False, report=False)
    cold, warm = study.state.trainings
    assert (cold.start, warm.start) == (None, Policy(0, 2))
    policy = study.policies[0, 2]
    seed = mbtl.seeds.training_seed(3, 0, 8, 0)
    alone = Slow().train([{"x": 0.8}], seed, length=1 / 8, start=policy)
    assert np.array_equal(study.policies[1, 0], alone.policy)
    scratch = Slow().train([{"x": 0.8}], seed, length=1 / 8)
    assert alone.policy[1] > scratch.policy[1]
    assert study.trail.trainings[1].start == Policy(0, 2)
    assert study.summary().trainings[1].trained_on == "x = 0.8, from training 1 at 32K"


def test_kept_and_read_back_it_goes_on_and_says_where_it_began(tmp_path):
    calm = opened(Slow(), strategy=STORY)
    calm.run(progress=False)

    class Interrupt(KeyboardInterrupt):
        pass

    class Stops(mbtl.study.steps.callbacks.StepCallback):
        def on_training(self, study, training, source, to):
            if training == 1:
                raise Interrupt

    study = opened(Slow(), tmp_path, strategy=STORY)
    for _ in range(2):  # decided and not begun: the start is read back from the log
        with pytest.raises(Interrupt):
            study.run(progress=False, callbacks=[Stops()])
        study = opened(Slow(), tmp_path, strategy=STORY)
    (held,) = study.state.under_way.values()
    assert (held.work, held.lease) == (BEGUN, None)  # given back
    study.run(progress=False)
    assert outcome(study) == outcome(calm)
    receipts = [json.loads(p.read_text()) for p in tmp_path.glob("policies/**/*-0003-*/*.json")]
    assert receipts
    assert all({"training": 1, "mark": 2} in receipt.values() for receipt in receipts)


def test_where_its_state_is_lost_a_training_is_made_again_from_the_same_start(tmp_path):
    calm = opened(Slow(), strategy=STORY)
    calm.run(progress=False)

    class Loses(mbtl.study.steps.callbacks.StepCallback):
        def on_training(self, study, training, source, to):
            if training == 1 and to > 8_000:
                for file in tmp_path.glob("policies/**/*0003*partial*"):
                    lost.append(file)
                    shutil.rmtree(file) if file.is_dir() else file.unlink()

    lost = []
    study = opened(Slow(), tmp_path, strategy=STORY)
    study.run(progress=False, callbacks=[Loses()])
    assert lost
    assert outcome(study) == outcome(calm)


def evaluate(policy, contexts, seeds):
    return [policy[1] - abs(c["x"] - policy[0]) for c in contexts]


def functions_study(strategy, lengths=(10_000, 20_000)):
    return mbtl.create_study(
        SPACE, cost="steps", budget=100_000, lengths=lengths, horizon=10, bounds=(0.0, 1.0),
        strategy=strategy,
    )  # fmt: skip


def keep(policy, folder):
    np.save(folder / "p.npy", policy)


def read(folder):
    return np.load(folder / "p.npy")


def test_a_plain_function_begins_from_its_start():
    begun = []

    def train(context, seed, start=None, length=None):
        begun.append(None if start is None else start[0])
        skill = 0.0 if start is None else start[1]
        return np.array([context["x"], skill + length / 4])

    study = functions_study(Warm())
    study.run(train, evaluate, save=keep, load=read, progress=False)
    assert begun[:2] == [None, 0.5]  # the second piece of the first one
    warm = [t for t in study.state.trainings if t.start is not None]
    assert warm
    first = study.space.context(study.state.trainings[warm[0].start.training].source)["x"]
    assert first in begun[2:]


@pytest.mark.parametrize("strategy", [Warm(), STORY])
def test_functions_that_take_no_start_are_refused_before_anything_is_spent(strategy):
    study = functions_study(strategy, [10_000])
    with pytest.raises(
        InvalidInput, match=r"begins trainings with .* train\(context, seed\); give train\(contexts"
    ):
        study.run(lambda context, seed: (context["x"], 1.0), evaluate, progress=False)
    with pytest.raises(InvalidInput, match=r"its function is train\(context, seed, length\)"):
        study.run(lambda context, seed, length: (context["x"], 1.0), evaluate, progress=False)
    assert study.state.spent == 0


@pytest.mark.parametrize("start", [Policy(1, 0), Policy(0, 1), Policy(-1, 0), Policy(0, -1)])
def test_a_start_that_is_not_there_is_refused(start):
    script = Script(Start(5, 0), Evaluate(Policy(0, 0), (5,)), Start(6, 0, start))
    with pytest.raises(InvalidInput, match="a mark that a training has passed"):
        opened(Slow(), strategy=script).run(progress=False)


def test_a_strategy_that_does_not_say_so_beforehand_is_refused_at_its_start():
    silent = Script(Start(5, 0), Evaluate(Policy(0, 0), (5,)), Start(6, 0, Policy(0, 0)))
    silent.starts_warm = False
    study = functions_study(silent, [10_000])
    with pytest.raises(InvalidInput, match="begins trainings with the weights of others"):
        study.run(lambda context, seed: (context["x"], 1.0), evaluate, progress=False)


def test_the_replay_of_curves_says_that_no_curve_has_it():
    world = StepWorld(mbtl.load_curves("pendulum-timestep", "hidden"), seed=0)
    trail = mbtl.actions.Trail(world.selection.steps)
    trail = world.act(trail, Start(50, 0))
    with pytest.raises(InvalidInput, match="in no curve; replay a strategy that begins from scr"):
        world.act(trail, Start(60, 0, Policy(0, 0)))
