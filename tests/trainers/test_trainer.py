"""The trainer contract of plain functions: each is given what its signature takes, and no more."""

from functools import partial
from pathlib import Path

import pytest

from mbtl.errors import InvalidInput, TrainingFailed
from mbtl.trainers.contract import FunctionTrainer, Trained, Trainer, refusal

ONE, TWO = [{"x": 1.0}], [{"x": 1.0}, {"x": 2.0}]


def of(train, **functions):
    return FunctionTrainer(train, lambda policy, contexts: [0.0 for _ in contexts], **functions)


def everything(contexts, seed, *, start=None, length=None, on_progress=None):
    return [c["x"] for c in contexts], seed, start, length, on_progress


@pytest.mark.parametrize(
    ("train", "takes"),
    [
        (lambda context, seed: 0, set()),
        (lambda context, seed, on_progress: 0, set()),
        (lambda contexts, seed: 0, {"sets"}),
        (lambda context, seed, length: 0, {"length"}),
        (lambda seed, contexts, start=None: 0, {"start"}),  # the first one is what it trains on
        (everything, {"sets", "start", "length"}),
        (partial(everything, length=0.5), {"sets", "start", "length"}),
        (dict, set()),  # written in C: nobody knows what it takes
    ],
)
def test_what_a_function_can_do_is_read_from_its_signature(train, takes):
    assert of(train).takes == takes


def test_a_function_is_given_what_it_takes():
    assert of(lambda context, seed: (context, seed)).train(ONE, 7).policy == (ONE[0], 7)
    made = of(everything).train(TWO, 7, on_progress=print).policy
    assert made == ([1.0, 2.0], 7, None, None, print)
    asked = {"start": "policy", "length": 0.5, "state": Path("nowhere")}
    assert of(everything).train(ONE, 7, **asked) == Trained(([1.0], 7, "policy", 0.5, None))


def test_going_on_is_asked_for_what_is_missing():
    trainer = of(everything)
    gone_on = trainer.train(ONE, 7, start="policy", done=0.25, length=1.0).policy
    assert gone_on == ([1.0], 7, "policy", 0.75, None)
    there = trainer.train(ONE, 7, start="policy", done=0.5, length=0.5)
    assert there == Trained("policy")


@pytest.mark.parametrize("functions", [(None, len), (everything, None), ("train", len)])
def test_what_is_no_function_is_refused_before_anything_is_trained(functions):
    with pytest.raises(InvalidInput, match="must be a function, got"):
        FunctionTrainer(*functions)


def test_a_policy_that_cannot_be_copied_says_so_and_what_would_help():
    with pytest.raises(TrainingFailed, match=r"cannot be copied \(.*give save and load functions"):
        of(everything).train(ONE, 7, start=(x for x in ()))


@pytest.mark.parametrize(
    ("returns", "words"),
    [(None, "None; does the function return"), (["a"], "real numbers"), ([[1], [1, 2]], "one len")],
)
def test_returns_are_judged_as_they_were_given(returns, words):
    trainer = FunctionTrainer(everything, lambda policy, contexts: returns)
    with pytest.raises(TrainingFailed, match=words):
        trainer.evaluate(0, TWO, [1, 2])


def test_a_function_may_change_its_start_in_its_place():
    def grow(context, seed, start=None):
        start.append(seed)
        return start

    def save(policy, folder):
        (folder / "policy").write_text(str(policy))

    def load(folder):
        return ["as read", *eval((folder / "policy").read_text())]

    first = [1]
    assert of(grow).train(ONE, 2, start=first).policy == [1, 2]
    kept = of(grow, save_fn=save, load_fn=load)
    assert kept.train(ONE, 2, start=first).policy == ["as read", 1, 2]
    assert first == [1]


@pytest.mark.parametrize(
    ("contexts", "asked", "said"),
    [
        ([], {}, "at least one context, got none"),
        (ONE, {"length": 0}, "longer than 0 units, got length=0"),
        ({"x": 1.0}, {}, r"a list of contexts, got one by itself, \{'x': 1\.0\}; write train"),
        (TWO, {}, "one policy on several contexts"),
        (ONE, {"start": 0}, "begin with the weights of a policy"),
        (ONE, {"length": 0.5}, r"for a length .* is train\(context, seed\); give train"),
    ],
)
def test_what_a_function_does_not_take_is_refused(contexts, asked, said):
    with pytest.raises(InvalidInput, match=said):
        of(lambda context, seed: 0).train(contexts, 0, **asked)


def test_a_class_says_what_it_can_do_and_why_not():
    class Mine(Trainer):
        takes = frozenset({"start"})

    assert refusal(Mine(), "start") is None
    assert refusal(Mine(), "sets").endswith("contexts: its `takes` does not name 'sets'")
    assert (Mine().whole, Mine().counts, Mine().policy_format) == (None, "steps", "custom")


def by_context(context, seed):
    return 0.0


def returns(policy, contexts, seeds):
    return [0.0] * len(contexts)


@pytest.mark.parametrize(
    ("functions", "words"),
    [
        ({"train": lambda ctx: 0}, r"train must be .* got train\(ctx\) \(too many"),
        ({"train": lambda seed, contexts, must: 0}, "missing a required argument: 'must'"),
        ({"train": lambda contexts, seed, *, start=None, lenght=None: 0}, "write 'length'"),
        ({"evaluate": lambda policy: 0}, r"evaluate must be .* got evaluate\(policy\)"),
    ],
)
def test_functions_that_cannot_be_called_are_refused_where_they_are_given(functions, words):
    given = {"train": by_context, "evaluate": returns} | functions
    with pytest.raises(InvalidInput, match=words):
        FunctionTrainer(given["train"], given["evaluate"])


def test_a_training_that_forgets_to_return_has_failed():
    with pytest.raises(TrainingFailed, match="train gave None"):
        FunctionTrainer(lambda context, seed: None, returns).train([{"x": 0.0}], 0)


@pytest.mark.parametrize("train", [by_context, lambda *a, **k: 0, lambda c, s, *, starts=5: 0])
@pytest.mark.parametrize(
    "evaluate",
    [returns, max, lambda p, c: 0, lambda p, c, *, seed: 0, lambda p, c, s, *, starts=None: 0],
)
def test_functions_that_can_be_called_are_taken(train, evaluate):
    assert FunctionTrainer(train, evaluate).takes == frozenset()
