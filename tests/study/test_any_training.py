"""Picks of every kind: on one context, several or all; from a policy; longer; only evaluated."""

from __future__ import annotations

import ast
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import pytest
import quick_problem

import mbtl
from flat import created, ran
from mbtl.errors import InvalidInput, StudyError
from mbtl.seeds import training_seed
from mbtl.selectors import Proposal, Traits
from scripted import Scripted

N = 8
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 7.0): N})
ALL = tuple(range(N))


@dataclass
class Simulator:
    """A policy is where it was trained and for how long; what it was asked for is kept."""

    calls: list = field(default_factory=list)

    def train(self, contexts, seed, *, start=None, length=None):
        self.calls.append(([c["x"] for c in contexts], seed, start, length))
        before = 0.0 if start is None else start["units"]
        return {"at": float(np.mean([c["x"] for c in contexts])), "wide": len(contexts),
                "units": before + (1.0 if length is None else length)}  # fmt: skip

    def evaluate(self, policy, contexts, seeds):
        reach = 0.1 if policy["wide"] == 1 else 0.01
        return [
            1.0 - reach * abs(c["x"] - policy["at"]) - 0.2 * policy["wide"] / N / policy["units"]
            for c in contexts
        ]


def study_of(strategy, budget=4, **settings):
    return created(SPACE, budget=budget, strategy=strategy, bounds=(0.0, 1.0), **settings)


def run(study, simulator, **how):
    return ran(study, simulator.train, simulator.evaluate, **how)


# ---- strategies ---------------------------------------------------------------------------------


def test_all_contexts_first_and_then_specialists():
    simulator, study = Simulator(), study_of("all-first")
    result = run(study, simulator)
    assert [len(call[0]) for call in simulator.calls] == [N, 1, 1, 1]
    assert [call[3] for call in simulator.calls] == [1.0, None, None, None]
    first, *others = study.state.rows
    assert first.sources == ALL
    assert first.source == 3  # the one in their middle, where it is drawn
    for row, call in zip(others, simulator.calls[1:], strict=True):
        assert call[1] == training_seed(0, 0, row.source)  # as alone, whatever came before
    assert simulator.calls[0][1] == training_seed(0, 0, ALL)
    rows = np.array([row.returns for row in study.state.rows])
    assert result.value == pytest.approx(rows.max(axis=0).mean())
    portfolio = study.portfolio()
    assert portfolio.sets == {0: ALL}
    assert portfolio.policy(0)["wide"] == N
    assert study.state.paid == 4.0


@pytest.mark.parametrize("fails", [False, True])
def test_where_no_policy_for_all_can_be_had_there_are_specialists_only(fails):
    simulator, study = Simulator(), study_of("all-first")

    def breaks(contexts, seed, *, start=None, length=None):
        if len(contexts) > 1:
            raise RuntimeError("out of memory")
        return simulator.train(contexts, seed, start=start, length=length)

    study.tell(0, np.full(N, 0.2))  # a policy that was there before
    train = breaks if fails else (lambda context, seed: simulator.train([context], seed))
    study.run(train, simulator.evaluate, progress=False)
    assert [failure.pick for failure in study.state.failures] == [0] * fails
    told = [row.sources for row in study.state.rows][1:]
    assert told == [(pick.source,) for pick in study.state.picks[fails:]]
    assert len(told) == 4 - fails


@pytest.mark.parametrize("parallel", [1, 2])
def test_one_policy_goes_on_with_its_own_weights(parallel):
    simulator, study = Simulator(), study_of("one-policy", budget=7)
    with_threads = {} if parallel == 1 else {"parallel": 2, "executor": ThreadPoolExecutor(2)}
    run(study, simulator, report=False, **with_threads)
    assert [row.length for row in study.state.rows] == [1.0, 2.0, 4.0, 7.0]
    assert [call[3] for call in simulator.calls] == [1.0, 1.0, 2.0, 3.0]  # how much more
    assert {call[1] for call in simulator.calls} == {training_seed(0, 0, ALL)}
    assert [None if call[2] is None else call[2]["units"] for call in simulator.calls] == [
        None, 1.0, 2.0, 4.0,
    ]  # fmt: skip
    assert [pick.price for pick in study.state.picks] == [1.0, 1.0, 2.0, 3.0]
    assert study.stop_reason == "the budget of 7 trainings is spent"
    assert study.history.made(2).goes_on


def test_a_budget_of_units_may_exceed_the_contexts_but_not_of_a_selector():
    assert study_of("one-policy", budget=3 * N).spec.budget == 3 * N
    study = study_of("one-policy", budget=2)
    study.extend(5 * N)
    assert study.spec.budget == 5 * N
    study.ask()
    with pytest.raises(mbtl.StudyFinished, match="the one policy is in training"):
        study.ask()
    with pytest.raises(InvalidInput, match=r"number of contexts \(8\), got 9"):
        study_of("mbtl", budget=N + 1)
    with pytest.raises(InvalidInput, match=r"of 8 contexts\), got 9 trainings"):
        study_of("mbtl", budget=2).extend(9)


# ---- tuned, longer, only evaluated --------------------------------------------------------------

EVERYBODY = Proposal(3, "all", length=1.0, sources=ALL)


def test_a_tuned_copy_has_a_seed_of_its_lineage():
    copies = [Proposal(5, "tuned", start=0, length=0.5), Proposal(6, "tuned", start=0, length=0.5)]
    seeds = []
    for order in (copies, copies[::-1]):
        simulator, study = Simulator(), study_of(Scripted((EVERYBODY, *order)), budget=2)
        run(study, simulator)
        assert [call[2] and call[2]["wide"] for call in simulator.calls] == [None, N, N]
        assert [call[3] for call in simulator.calls] == [1.0, 0.5, 0.5]
        assert [row.length for row in study.state.rows] == [1.0, 0.5, 0.5]
        assert study.state.paid == 2.0
        seeds.append({row.source: call[1] for row, call in
                      zip(study.state.rows, simulator.calls, strict=True)})  # fmt: skip
    assert seeds[0] == seeds[1]  # never the pick number
    assert seeds[0][5] != training_seed(0, 0, 5)
    assert len(set(seeds[0].values())) == 3


def test_what_goes_on_is_read_back_by_another_process(tmp_path):
    def save(policy, folder):
        (folder / "policy").write_text(repr(policy))

    def load(folder):
        return ast.literal_eval((folder / "policy").read_text())

    simulator, place = Simulator(), tmp_path / "study.db"
    first = study_of("one-policy", budget=4, storage=place)
    functions = {"save": save, "load": load, "progress": False, "report": False}

    def until_two(contexts, seed, *, start=None, length=None):
        if start is not None and start["units"] == 2.0:
            raise KeyboardInterrupt
        return simulator.train(contexts, seed, start=start, length=length)

    with pytest.raises(KeyboardInterrupt):
        ran(first, until_two, simulator.evaluate, **functions)
    again = mbtl.load_study(place)
    assert [row.length for row in again.state.rows] == [1.0, 2.0]
    assert len(again.orphans) == 1
    ran(again, simulator.train, simulator.evaluate, accept_changes=True, **functions)
    assert [row.length for row in again.state.rows] == [1.0, 2.0, 4.0]
    assert again.portfolio(again.trainer or None).sets == {0: ALL, 1: ALL, 2: ALL}
    assert simulator.calls[-1][2]["units"] == 2.0


def test_asked_and_told_by_hand():
    study = study_of(Scripted((EVERYBODY, Proposal(5, "tuned", start=0, length=0.5))), budget=2)
    pick = study.ask()
    assert pick.sources == ALL
    assert [context["x"] for context in pick.contexts] == list(range(N))
    assert str(pick) == "pick 1: 8 contexts (all)"
    study.tell(pick, np.full(N, 0.5), policy_object="everybody")
    tuned = study.ask()
    assert (tuned.sources, tuned.start, tuned.length) == ((5,), study.state.rows[0].event, 0.5)
    study.tell(tuned, np.full(N, 0.6))
    study.tell([1, 2], np.full(N, 0.7))  # a policy on two contexts that was there before
    assert [row.sources for row in study.state.rows] == [ALL, (5,), (1, 2)]
    assert study.value == pytest.approx(0.7)
    with pytest.raises(StudyError, match="2 contexts was told before"):
        study.tell([1, 2], np.full(N, 0.7))


def test_selectors_see_specialists_only():
    study = study_of("greedy")
    study.tell(ALL, np.full(N, 0.9))
    alone = study_of("greedy")
    assert study.ask().source == alone.ask().source


# ---- what is refused ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("proposal", "words"),
    [
        (Proposal(0, "x", start=4), "policy of a row, 0 to 0, got start=4"),
        (Proposal(0, "x", length=-1.0), "a length >= 0 in units, got -1"),
        (Proposal(0, "x", length=0.0), r"names the policy, start=, and its targets="),
        (Proposal(3, "x", start=0, length=0.5, sources=ALL), "goes on beyond the 1 units"),
        (Proposal(3, "x", start=0, length=9.0, sources=ALL), "got 8 units where 1 are spent"),
        (Proposal(3, "x", sources=(1, 2)), "with `source` among them, got 3"),
        (Proposal(3, "x", sources=(3, 3)), "different ones of several"),
    ],
)
def test_a_strategy_that_breaks_its_contract_is_named(proposal, words):
    study = study_of(Scripted((EVERYBODY, proposal)))
    study.tell(study.ask(), np.full(N, 0.5))
    with pytest.raises(InvalidInput, match=words) as caught:
        study.ask()
    assert "'scripted'" in str(caught.value)
    assert len(study.state.picks) == 1


def test_neither_a_selector_nor_a_trainer_of_one_context_is_asked_for_more():
    @dataclass(frozen=True)
    class Bold(Scripted):
        traits: ClassVar[Traits] = Traits()

    with pytest.raises(InvalidInput, match=r"says so by traits = Traits\(any_training=True\)"):
        study_of(Bold((EVERYBODY,))).ask()
    study = study_of(Scripted((EVERYBODY,)))
    with pytest.raises(InvalidInput, match="cannot do what 'scripted' asks for, one policy on"):
        study.run(lambda context, seed: 1.0, lambda p, c, s: np.ones(len(c)), progress=False)


def test_a_policy_that_was_taken_back_is_not_begun_with():
    study = study_of(Scripted((EVERYBODY, Proposal(5, "tuned", start=0, length=0.5))))
    simulator = Simulator()
    pick = study.ask()
    study.tell(pick, np.full(N, 0.5), policy_object={"units": 1.0})
    study.release(study.ask())
    study.void(0, "the simulator was misconfigured")
    with pytest.raises(StudyError, match="begins with a policy that was taken back"):
        run(study, simulator)
    study.fail(study.ask(), "its beginning is gone")
    assert not study.state.open_picks


def test_sets_and_what_goes_on_are_trained_in_other_processes(tmp_path):
    everybody = Proposal(7, "all", length=0.5, sources=tuple(range(15)))
    further = replace(everybody, reason="longer", start=0, length=1.0)
    found = []
    for parallel in (1, 2):
        study = mbtl.create_study(
            quick_problem.SPACE, budget=2, storage=tmp_path / f"{parallel}.db",
            strategy=Scripted((everybody, Proposal(2, "alone", length=0.3), further)),
        )  # fmt: skip
        ran(study, trainer=quick_problem.ANY_TRAINER, parallel=parallel, deterministic=True,
            report=False)  # fmt: skip
        rows = sorted(study.state.rows, key=lambda row: (len(row.sources), row.length))
        found.append([(row.sources, row.length, row.returns.tolist()) for row in rows])
        assert [row.length for row in rows] == [0.3, 0.5, 1.0]
        assert len(study.portfolio().sets) == 2
    assert found[0] == found[1]
