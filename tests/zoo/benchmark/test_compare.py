"""Comparisons: closed answers of the linear-gap world, and what a selector is shown."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from mbtl.errors import InvalidInput, UnknownName
from mbtl.selectors import get_selector
from mbtl.selectors.base import Exhausted, Proposal
from mbtl.selectors.contract import Traits, traits_of
from mbtl.zoo.benchmark import TransferMatrix, compare, linear_gap_world, random_curve
from mbtl.zoo.benchmark.compare import default_selectors

WORLD = "synthetic:linear-gap"


def runs_of(comparison, selector):
    return [run for run in comparison.results if run.selector == selector]


@pytest.fixture(scope="module")
def world_comparison():
    return compare(["mbtl", "greedy", "equidistant", "oracle"], [WORLD], budget=15)


@pytest.mark.parametrize(
    ("selector", "sources", "v4", "v15"),
    [
        ("greedy", [49, 82, 16, 32, 65, 40, 73, 93, 5, 24, 57, 10, 87, 44, 77], 0.8652, 0.8909),
        ("oracle", [49, 82, 16, 32, 65, 93, 5, 40, 74, 23, 56, 10, 87, 97, 1], 0.8652, 0.8911),
        ("equidistant", [96, 89, 82, 76, 69, 63, 56, 49, 43, 36, 30, 23, 16, 10, 3], None, 0.89175),
        ("mbtl", [49, 99, 0, 74], 0.8544, None),
    ],
)
def test_closed_answers_of_the_linear_gap_world(world_comparison, selector, sources, v4, v15):
    (run,) = runs_of(world_comparison, selector)
    assert list(run.sources[: len(sources)]) == sources
    if v4 is not None:
        assert run.performance[3] == pytest.approx(v4, abs=5.1e-5)
    if v15 is not None:
        assert run.performance[14] == pytest.approx(v15, abs=1e-9)
    assert run.theta == 0.005


def test_every_matrix_seed_and_selector_seed_is_run():
    returns = np.random.default_rng(0).normal(size=(2, 12, 12))
    matrix, steps = TransferMatrix.of(returns, name="mine"), []
    asked = {"budget": 4, "seeds": 3}
    result = compare(["random", "greedy", "oracle"], [matrix], on_step=steps.append, **asked)
    assert [step.done for step in steps] == list(range(2 * (1 + 3 + 1) + 1))
    assert (steps[-1].total, steps[-1].doing) == (10, "")
    again = compare(["random", "greedy", "oracle"], [matrix], **asked)
    assert [run.sources for run in result.results] == [run.sources for run in again.results]
    keys = [(r.selector, r.matrix_seed, r.seed) for r in result.results]
    expected = {("random", m, s) for m in (0, 1) for s in (0, 1, 2)}
    expected |= {(name, m, 0) for m in (0, 1) for name in ("greedy", "oracle")}
    assert len(keys) == len(set(keys))
    assert set(keys) == expected
    assert {r.matrix for r in result.results} == {"mine"}
    orders = {r.sources for r in runs_of(result, "random")}
    assert len(orders) == 6  # every seed draws its own order
    for run in result.results:
        assert len(set(run.sources)) == 4
        j = matrix.performance(run.matrix_seed)
        curve = [j[list(run.sources[:k])].max(axis=0).mean() for k in range(1, 5)]
        assert run.performance == pytest.approx(curve)
        assert run.select_seconds > 0


def test_random_is_summarised_by_its_exact_expectation():
    result = compare(["random"], [WORLD], budget=5, seeds=1)
    exact = random_curve(linear_gap_world(), 0, 5)
    assert result.summary.pooled["random"].V_K.value == pytest.approx(exact[-1])
    assert result.summary.pooled["random"].closed_at_K.value == pytest.approx(0.0, abs=1e-12)
    assert runs_of(result, "random")[0].performance[-1] != pytest.approx(exact[-1], abs=1e-6)


def test_the_oracle_closes_everything(world_comparison):
    oracle = world_comparison.summary.pooled["oracle"]
    assert oracle.closed_at_K.value == pytest.approx(1.0)
    assert oracle.closed_under_curve.value == pytest.approx(1.0)
    assert world_comparison.summary.pooled["equidistant"].closed_at_K.value > 1.0  # it is myopic


@dataclass
class Recorder:
    """Takes contexts in order and keeps what it was shown."""

    name: str = "recorder"
    traits: ClassVar[Traits] = Traits(deterministic=True)
    seen: list = field(default_factory=list)

    def propose(self, problem, history, rng):
        self.seen.append((problem, history))
        return Proposal(len(history), "next")


def test_a_selector_object_sees_only_told_rows():
    recorder = Recorder()
    matrix = TransferMatrix.of(np.arange(32.0).reshape(2, 4, 4), bounds=(0, 32), theta=0.2)
    result = compare([recorder], [matrix], budget=3, seeds=5)
    assert len(result.results) == 2  # deterministic: once per matrix seed
    problem, history = recorder.seen[-1]
    assert problem.theta == 0.2
    assert problem.budget == 3
    assert np.array_equal(history.rows, matrix.performance(1)[:2])


class Coin:
    """Random, of a user's own; it says nothing of that."""

    name = "coin"

    def propose(self, problem, history, rng):
        return Proposal(int(rng.choice(np.flatnonzero(history.open_mask(problem.n)))), "any")


def test_a_selector_of_a_users_own_is_run_with_all_seeds_unless_it_says_that_one_is_enough():
    result = compare([Coin()], [TransferMatrix.of(np.eye(9)[None])], budget=4, seeds=4)
    assert [run.seed for run in result.results] == [0, 1, 2, 3]
    assert len({run.sources for run in result.results}) > 1
    assert traits_of(Recorder()).deterministic
    assert traits_of(get_selector("mbtl")).deterministic
    assert not traits_of(get_selector("random")).deterministic


class Stuck:
    name = "stuck"

    def __init__(self, answer):
        self.answer = answer

    def propose(self, problem, history, rng):
        if not isinstance(self.answer, Exception):
            return self.answer
        if history.sources:
            raise self.answer
        return Proposal(0, "")


@pytest.mark.parametrize(
    ("answer", "match"),
    [
        (Proposal(2, "always"), "2 again from 'stuck' at pick 2"),
        (Proposal(3, "always"), "got 3"),
        (Proposal(1.0, ""), "got 1.0"),
        (Proposal(True, ""), "got True"),
        (Proposal(0, "", sources=(0, 1)), "one context, from scratch"),
        (None, "got NoneType None from 'stuck'"),
        (Exhausted("enough"), "2 picks of each selector, got none at pick 2 from 'stuck': enough"),
    ],
)
def test_what_no_study_would_take_is_refused_in_a_comparison_too(answer, match):
    with pytest.raises(InvalidInput, match=match):
        compare([Stuck(answer)], [TransferMatrix.of(np.eye(3)[None])], budget=2)


def test_a_selector_whose_first_pick_cannot_be_is_refused_before_any_work():
    def nothing(problem, history, rng):
        raise Exhausted("enough")

    some, steps = TransferMatrix.of(np.eye(3)[None, :2], sources=[0, 1]), []
    silent = SimpleNamespace(name="stuck", propose=nothing)
    for selector, match in (
        (
            Stuck(Proposal(2, "")),
            "'stuck' cannot run on matrix .* may train on, got 2 .*open_candidates",
        ),
        (silent, "'stuck' cannot run on matrix .*: enough"),
    ):
        with pytest.raises(InvalidInput, match=match):
            compare([selector], [some], budget=2, on_step=steps.append)
    assert steps == []


def test_a_file_and_the_id_of_one_matrix_are_held_out_alike(tmp_path):
    asked = []

    class Learned(Recorder):
        def without(self, family):
            asked.append(family)
            return Recorder()

    matrix = TransferMatrix.of(np.eye(3)[None], provenance={"problem": "cartpole-length"})
    matrix.save(tmp_path / "any-name.npz")
    nameless = TransferMatrix.of(np.eye(3)[None], name="cartpole-mass")
    compare([Learned()], [tmp_path / "any-name.npz", nameless, WORLD], budget=2)
    assert asked == ["cartpole", "", ""]


def test_reference_rows_stand_beside_the_selectors():
    returns = np.array([[[0.0, 0.5], [1.0, 0.5]]])
    matrix = TransferMatrix.of(
        returns, bounds=(0, 1), contexts=[[1.0], [2.0]], axes=["x"], fresh_returns=returns / 2,
        references={"unguided": np.array([[[0.3, 0.3], [0.1, 0.2]]])},
        provenance={"nominal": {"x": 1.9}},
    )  # fmt: skip
    summary = compare(["random"], [matrix], budget=1).summary.matrices["matrix"]
    assert summary.caveat is None
    assert list(summary.references) == ["unguided", "nominal_policy", "random_policy"]
    assert list(summary.references.values()) == pytest.approx([0.15, 0.375, 0.25])
    assert compare(["random"], [WORLD], budget=1).summary.matrices[WORLD].caveat is None


def test_selectors_for_one_axis_are_left_out_by_default_and_refused_by_name():
    cube = "synthetic:3d-lin-lin-nd-eta0"
    names = default_selectors([WORLD, cube])
    assert "greedy" not in names
    assert "equidistant" not in names
    assert {"random", "mbtl", "oracle"} <= set(names)
    assert "greedy" in default_selectors([WORLD])
    with pytest.raises(InvalidInput, match="'greedy' cannot run on matrix 'synthetic:3d"):
        compare(["greedy"], [cube], budget=2)


@pytest.mark.parametrize(
    ("selectors", "kwargs", "error", "match"),
    [
        (["mbtll"], {}, UnknownName, "Did you mean 'mbtl'"),
        (["oracel"], {}, UnknownName, "Did you mean 'oracle'"),
        ([], {}, InvalidInput, "one or more selectors"),
        ("random", {}, InvalidInput, "list of names"),
        (["random", "random"], {}, InvalidInput, "twice"),
        ([SimpleNamespace(name="random", propose=print)], {}, InvalidInput, "name of a reference"),
        (["auto"], {}, InvalidInput, "asks for trainings of every kind; replay it"),
        (["random"], {"budget": 0}, InvalidInput, "budget"),
        (["random"], {"budget": 101}, InvalidInput, "'synthetic:linear-gap'.*budget"),
        (["random"], {"seeds": 0}, InvalidInput, "seeds"),
    ],
)
def test_wrong_use_is_refused_before_any_work(selectors, kwargs, error, match):
    steps = []
    with pytest.raises(error, match=match):
        compare(selectors, [WORLD], on_step=steps.append, **kwargs)
    assert steps == []


@pytest.mark.parametrize("matrices", [WORLD, "all", None])
def test_matrices_are_given_in_a_list(matrices):
    with pytest.raises(InvalidInput, match="matrices are given in a list"):
        compare(["random"], matrices)


def test_a_budget_beyond_several_matrices_names_them_all():
    small = [
        TransferMatrix.of(np.random.default_rng(n).normal(size=(1, n, n)), name=f"m{n}")
        for n in (4, 6, 9)
    ]
    with pytest.raises(InvalidInput, match=r"7 is more than m4 \(4\), m6 \(6\).*take 4 or fewer"):
        compare(["greedy"], small, budget=7)
