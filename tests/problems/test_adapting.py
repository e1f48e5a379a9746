"""A policy is tuned for one target more, and kept where it is better there."""

from dataclasses import replace

import numpy as np
import pytest
from line_problem import load, save

import mbtl
from mbtl.portfolio import load_portfolio
from mbtl.problems import adapt, with_adapted

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 10.0): 6})


def train(contexts, seed, *, start=None, length=None):
    """A policy is a place; tuning moves it to the target, as far as it is trained."""
    middle = float(np.mean([context["x"] for context in contexts]))
    return middle if start is None else start + min(length, 1.0) * (middle - start)


def evaluate(policy, contexts, seeds):
    luck = [np.random.default_rng(seed).normal(0.0, 0.02, 4) for seed in seeds]
    return np.array([10.0 - abs(c["x"] - policy) + r for c, r in zip(contexts, luck, strict=True)])


problem = mbtl.CMDP.from_functions(
    "toy", SPACE, train=train, evaluate=evaluate, save=save, load=load, bounds=(0.0, 10.0)
)
fixed = mbtl.CMDP.from_functions(
    "toy", SPACE, train=lambda context, seed: context["x"], evaluate=evaluate, save=save, load=load,
    bounds=(0.0, 10.0),
)  # fmt: skip


def crash(contexts, seed, *, start=None, length=None):
    return 1 / 0


crashing = replace(problem, trainer=replace(problem.trainer, train_fn=crash))
TOY = f"{__file__}:problem"


@pytest.fixture
def toy(folder):
    study = mbtl.create_study(problem, budget=2, strategy="equidistant", storage="s/study.db")
    study.run(progress=False)
    study.portfolio().save("s/portfolio")
    return problem


def test_a_tuned_policy_that_is_better_joins_and_serves_around_its_target(toy, tmp_path):
    known = load_portfolio("s/portfolio", load=toy.trainer.load)
    target = {"x": 9.0}
    before = known.explain(target)
    found = adapt(known, toy, target, length=0.5)
    home = known.space.context(known.sources[before.policy])["x"]
    assert found.policy == pytest.approx(home + 0.5 * (9.0 - home))
    assert found.lead == pytest.approx(0.05 * abs(9.0 - home))
    assert found.is_better
    larger = with_adapted(known, toy, found, tmp_path / "larger")
    again = load_portfolio(tmp_path / "larger", load=toy.trainer.load)
    assert len(again) == len(larger) == len(known) + 1
    assert again.policy_for(target) == pytest.approx(found.policy)
    assert again.metadata["adapted"][0]["to"] == target
    away = abs(np.append(np.arange(6) * 2.0, 9.0) - found.policy)
    np.testing.assert_allclose(again.returns[-1], 10.0 - away, atol=0.1)
    assert again.value >= known.value  # the target itself has no weight
    assert again.explain({"x": 8.9}).policy == 2


def test_one_that_is_not_better_is_not_kept(toy, mbtl_command):
    known = load_portfolio("s/portfolio", load=toy.trainer.load)
    home = known.space.context(known.sources[0])
    found = adapt(known, toy, home)
    assert not found.is_better
    assert "It behaves the same there" in found.explanation
    unsure = replace(found, after=found.after + 1.0, lead=0.1, margin=0.2)
    assert unsure.explanation.startswith("Too few episodes to tell (run again with more eval_ep")


def test_the_command_tunes_says_and_adds(toy, mbtl_command):
    target = ("--to", "x=9", "--problem", TOY, "--trust")
    told = mbtl_command.document("adapt", "s/portfolio", *target)
    assert told["lead"] > told["margin"]
    assert len(load_portfolio("s/portfolio", trust=True)) == 3
    again = mbtl_command.done("adapt", "s/portfolio", *target)
    assert "Nothing was kept, and s/portfolio is as it was." in again
    study = ("--study", "s", "--strategy", "equidistant", "--budget", "2", "--all")
    code, _, told = mbtl_command("run", TOY, *study)
    assert code == 0, told
    assert "set aside: s/portfolio is now s/portfolio.1" in told
    assert len(load_portfolio("s/portfolio.1", trust=True)) == 3
    assert len(load_portfolio("s/portfolio", trust=True)) == 2


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--to", "x=9", "--problem", TOY), "--trust"),
        (("--to", "x", "--problem", TOY, "--trust"), "NAME=VALUE"),
        (("--to", "x=11", "--problem", TOY, "--trust"), "[0, 10]"),
        (
            ("--to", "x=9", "--problem", f"{__file__}:fixed", "--trust"),
            "cannot begin with the weights",
        ),
        (("--to", "x=9", "--problem", TOY, "--trust", "--steps", "5"), "--steps"),
    ],
)
def test_what_cannot_be_done_costs_one_line(toy, mbtl_command, more, words):
    assert words in mbtl_command.refusal("adapt", "s/portfolio", *more)


def test_a_training_that_fails_leaves_the_portfolio_as_it_was(toy, mbtl_command):
    given = ("--to", "x=9", "--problem", f"{__file__}:crashing", "--trust")
    code, _, told = mbtl_command("adapt", "s/portfolio", *given)
    assert code == 1
    assert "error: a policy could not be tuned for {'x': 9.0}: ZeroDivisionError" in told
    assert len(load_portfolio("s/portfolio", trust=True)) == 2


def test_contexts_between_are_served_and_compared_with_what_was_expected(toy):
    known = load_portfolio("s/portfolio", load=toy.trainer.load)
    found = known.evaluate(toy, between=400)
    places = np.array([one["x"] for one in found.contexts])
    homes = np.array([known.space.context(s)["x"] for s in known.sources])
    best = 1.0 - abs(places[:, None] - homes).min(axis=1) / 10.0
    assert found.value == pytest.approx(best.mean(), abs=0.02)
    assert 0.0 < found.margin < 0.03
    assert found.off < 0.05
    assert found.performances[places == found.worst["x"]].min() == found.performances.min()
    given = known.evaluate(toy, contexts=[{"x": 3.3}])
    assert given.returns.shape == (1, 4)
    assert 0.0 < given.margin < 0.02
    with pytest.raises(mbtl.InvalidInput, match="one context or more"):
        known.evaluate(toy, contexts=[])
    with pytest.raises(mbtl.InvalidInput, match=r"got one, {'x': 3.3}; write \[context\]"):
        known.evaluate(toy, contexts={"x": 3.3})
    with pytest.raises(mbtl.MbtlError, match=r"\[0, 10\]"):
        known.evaluate(toy, contexts=[{"x": 11.0}])


def test_episodes_without_a_return_are_left_out_of_what_is_served(toy):
    known = load_portfolio("s/portfolio", load=toy.trainer.load)

    def partly(policy, contexts, seeds):
        found = np.array(evaluate(policy, contexts, seeds), float)
        found[:, 0] = np.nan
        found[[context["x"] > 8.0 for context in contexts]] = np.nan
        return found

    broken = replace(toy.trainer, evaluate_fn=partly)
    found = known.evaluate(broken, contexts=[{"x": x} for x in (1.0, 3.3, 8.5)])
    assert (len(found.contexts), found.lost, found.returns.shape) == (2, 1, (2, 4))
    assert np.isfinite([found.value, found.margin, found.off]).all()
    assert "1 more gave no episode" in repr(found)
    with pytest.raises(mbtl.errors.TrainingFailed, match="NaN in all of 1 contexts"):
        known.evaluate(broken, contexts=[{"x": 8.5}])


def test_drawn_contexts_are_of_every_kind_of_axis():
    numbers, letters = mbtl.Integer("n", 1, 4), mbtl.Categorical("c", ("a", "b"))
    space = mbtl.ContextSpace.grid({mbtl.Log("m", 0.1, 10.0): 3, numbers: 2, letters: 2})
    drawn = space.between(500, seed=3)
    assert {one["n"] for one in drawn} == {1, 2, 3, 4}
    assert {one["c"] for one in drawn} == {"a", "b"}
    assert np.median([one["m"] for one in drawn]) == pytest.approx(1.0, rel=0.5)
    assert drawn == space.between(500, seed=3)
