"""Picks of every kind, and what they cost: in units, in environment steps, in the user's own."""

import json
import threading
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import pytest
import quick_problem
from line_problem import load, save

import mbtl
from flat import created, ran, told
from mbtl.errors import InvalidInput, StorageError, StudyError, TrainingFailed
from mbtl.report import summarise_study
from mbtl.report.subject import of_study
from mbtl.report.text import lines
from mbtl.seeds import training_seed
from mbtl.selectors import Exhausted, Proposal, Traits
from mbtl.study import StudyFinished
from mbtl.study.budget import counted
from mbtl.study.create import EPISODES
from mbtl.trainers import Progress, Trained, Trainer
from scripted import Scripted

pytestmark = pytest.mark.filterwarnings("ignore::mbtl.errors.UnsavedPolicies")
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


def simulated(study, simulator, **how):
    return ran(study, simulator.train, simulator.evaluate, **how)


def test_a_start_that_is_nowhere_spends_nothing(tmp_path):
    kept = mbtl.trainers.FunctionTrainer(Simulator().train, Simulator().evaluate, save, load)
    longer = replace(EVERYBODY, start=0, length=2.0)
    study = study_of(Scripted((EVERYBODY, longer)), storage=tmp_path / "study.db")
    study.tell(study.ask(), np.full(N, 0.5), policy="policies/none")
    with pytest.raises(StorageError, match="and nothing is there; bring it back"):
        study.run(trainer=kept, progress=False)
    assert (study.state.paid, study.state.failures) == (2.0, [])


# ---- strategies ---------------------------------------------------------------------------------


def test_all_contexts_first_and_then_specialists():
    simulator, study = Simulator(), study_of("all-first")
    result = simulated(study, simulator)
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
    simulated(study, simulator, report=False, threads=parallel)
    assert [row.length for row in study.state.rows] == [1.0, 2.0, 4.0, 7.0]
    assert [call[3] for call in simulator.calls] == [1.0, 1.0, 2.0, 3.0]  # how much more
    assert {call[1] for call in simulator.calls} == {training_seed(0, 0, ALL)}
    assert [None if call[2] is None else call[2]["units"] for call in simulator.calls] == [
        None, 1.0, 2.0, 4.0,
    ]  # fmt: skip
    assert [pick.price for pick in study.state.picks] == [1.0, 1.0, 2.0, 3.0]
    assert study.stop_reason == "the budget of 7 units is spent"
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
        simulated(study, simulator)
        assert [call[2] and call[2]["wide"] for call in simulator.calls] == [None, N, N]
        assert [call[3] for call in simulator.calls] == [1.0, 0.5, 0.5]
        assert [row.length for row in study.state.rows] == [1.0, 0.5, 0.5]
        assert study.state.paid == 2.0
        seeds.append({row.source: call[1] for row, call in
                      zip(study.state.rows, simulator.calls, strict=True)})  # fmt: skip
    assert seeds[0] == seeds[1]  # never the pick number
    assert seeds[0][5] != training_seed(0, 0, 5)
    assert len(set(seeds[0].values())) == 3


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
        (Proposal(0, "x", length=0.0), r"has a start= and targets="),
        (
            Proposal(3, "x", start=0, length=0.0, sources=ALL, targets=(1, 2)),
            r"evaluated once on a target, got targets where row 0 is known, under way or failed",
        ),
        (Proposal(3, "x", start=0, length=0.5, sources=ALL), "goes on beyond the 1 units"),
        (Proposal(3, "x", start=0, length=9.0, sources=ALL), "got 8 units where 1 are spent"),
        (Proposal(3, "x", sources=(1, 2)), "with `source` among them, got source=3"),
        (Proposal(3, "x", sources=(3, 3)), "different ones of several"),
    ],
)
def test_a_strategy_that_breaks_its_contract_is_refused(proposal, words):
    study = study_of(Scripted((EVERYBODY, proposal)))
    study.tell(study.ask(), np.full(N, 0.5))
    with pytest.raises(InvalidInput, match=words):
        study.ask()
    assert len(study.state.picks) == 1


def test_neither_a_selector_nor_a_trainer_of_one_context_is_asked_for_more():
    @dataclass(frozen=True)
    class Bold(Scripted):
        traits: ClassVar[Traits] = Traits()

    with pytest.raises(InvalidInput, match=r"says so by traits = Traits\(any_training=True\)"):
        study_of(Bold((EVERYBODY,))).ask()
    study = study_of(Scripted((EVERYBODY,)))
    with pytest.raises(InvalidInput, match="cannot train one policy on several contexts"):
        study.run(lambda context, seed: 1.0, lambda p, c, s: np.ones(len(c)), progress=False)


def test_a_policy_that_was_taken_back_is_not_begun_with():
    study = study_of(Scripted((EVERYBODY, Proposal(5, "tuned", start=0, length=0.5))))
    simulator = Simulator()
    pick = study.ask()
    study.tell(pick, np.full(N, 0.5), policy_object={"units": 1.0})
    study.release(study.ask())
    study.void(0, "the simulator was misconfigured")
    with pytest.raises(StudyError, match="begins with a policy that was taken back"):
        simulated(study, simulator)
    study.fail(study.ask(), "its beginning is gone")
    assert not study.state.open_picks


@dataclass(frozen=True)
class WhenTold(Scripted):
    """Goes on with a training when that is told, whichever row it has."""

    def propose(self, problem, history, rng):
        asked = super().propose(problem, history, rng)
        if asked.start is None:
            return asked
        if asked.source not in history.sources:
            raise Exhausted("it is in training")
        return replace(asked, start=history.sources.index(asked.source))


def test_sets_and_what_goes_on_are_trained_in_other_processes(tmp_path):
    everybody = Proposal(7, "all", length=0.5, sources=tuple(range(15)))
    further = replace(everybody, reason="longer", start=0, length=1.0)
    found = []
    for parallel in (1, 2):
        study = mbtl.create_study(
            quick_problem.SPACE, budget=2, storage=tmp_path / f"{parallel}.db",
            strategy=WhenTold((everybody, Proposal(2, "alone", length=0.3), further)),
        )  # fmt: skip
        ran(study, trainer=quick_problem.ANY_TRAINER, parallel=parallel, report=False)
        rows = sorted(study.state.rows, key=lambda row: (len(row.sources), row.length))
        found.append([(row.sources, row.length, row.returns.tolist()) for row in rows])
        assert [row.length for row in rows] == [0.3, 0.5, 1.0]
        assert len(study.portfolio().sets) == 2
    assert found[0] == found[1]


UNIT, EPISODE = 1_000, 25


@dataclass
class Walker(Trainer):
    """Learns by momentum, which is its state; notes each step that it really makes.

    A policy is what it weighs, where it is at home and how many contexts it is for.
    """

    made: dict = field(default_factory=lambda: dict.fromkeys(("train", "play"), 0))
    begun: list = field(default_factory=list)
    breaks: object = None
    looks: object = None
    lock: object = field(default_factory=threading.Lock)

    takes = frozenset({"sets", "start", "length", "state"})
    whole = UNIT

    def note(self, what, steps):
        with self.lock:
            self.made[what] += steps

    def train(
        self, contexts, seed, *, start=None, length=None, done=0.0, state=None,
        on_progress=None,
    ):  # fmt: skip
        """A hundred steps at a time."""
        until = round(10 * (1.0 if length is None else length))
        begun, had, weight, momentum = "scratch", 0, seed % 89, 0.0
        if start is not None:
            begun, had, weight = "weights", round(10 * done), start["weight"]
        if state is not None and state.exists():
            begun, (had, weight, momentum) = "state", json.loads(state.read_text())
        self.begun.append(begun)
        for one in range(had, until):
            momentum = 0.9 * momentum + 1.0
            weight += momentum
            self.note("train", UNIT // 10)
            if on_progress is not None:
                on_progress(Progress((one + 1) * UNIT // 10, until * UNIT // 10))
            if self.breaks is not None and self.breaks(contexts, one):
                raise FloatingPointError("diverged")
        if state is not None:
            state.write_text(json.dumps([until, weight, momentum]))
        home = float(np.mean([c["x"] for c in contexts]))
        policy = {"weight": weight, "home": home, "wide": len(contexts)}
        return Trained(policy, until * UNIT // 10)

    def evaluate_steps(self, policy, contexts, seeds):
        if self.looks is not None:
            self.looks()
        returns = [1.0 - 0.1 * abs(c["x"] - policy["home"]) / policy["wide"] for c in contexts]
        self.note("play", 2 * EPISODE * len(contexts))
        return np.tile(np.array(returns)[:, None], 2), np.full((len(contexts), 2), EPISODE)

    def evaluate(self, policy, contexts, seeds):
        return self.evaluate_steps(policy, contexts, seeds)[0]

    def save(self, policy, folder):
        (folder / "policy.json").write_text(json.dumps(policy))
        return True

    def load(self, folder):
        return json.loads((folder / "policy.json").read_text())


@dataclass(frozen=True)
class Mixed:
    """All contexts, then in turns longer, a tuned copy, and one alone."""

    name: str = "mixed"
    traits = Traits(any_training=True)

    def propose(self, problem, history, rng):
        asked = [one for one in history.asked if one.length]
        everyone = next((i for i in range(len(history)) if history.made(i).contexts == ALL), None)
        if not asked:
            return Proposal(3, "all", length=0.5, sources=ALL)
        if everyone is None:
            raise Exhausted("all that is left begins with the policy for all")
        which = len(asked) % 3
        last = max(
            (i for i in range(len(history)) if history.made(i).contexts == ALL),
            key=lambda i: history.made(i).length,
        )
        busy = any(one.contexts == ALL for one in history.under_way)
        if which == 0 and not busy:
            longer = history.made(last).length + 0.4
            return Proposal(3, "longer", start=last, length=longer, sources=ALL)
        taken = {one.contexts for one in asked}
        free = [c for c in range(N) if (c,) not in taken]
        if not free:
            raise Exhausted("every context had its turn")
        return Proposal(free[0], "one", start=everyone if which == 1 else None, length=0.3)


def in_steps(total, strategy="mixed", **settings):
    given = Mixed() if strategy == "mixed" else strategy
    budget = mbtl.Steps(total, unit=UNIT, horizon=EPISODE)
    return created(SPACE, budget=budget, strategy=given, bounds=(0.0, 1.0), **settings)


def run(study, trainer, parallel=1, **how):
    return ran(study, trainer=trainer, threads=parallel, report=False, rehearse=False, **how)


# ---- budgets in steps ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("strategy", "parallel"),
    [("mixed", 1), ("mixed", 2), ("all-first", 2), ("one-policy", 1), ("random", 2)],
)
def test_the_bill_is_what_was_played_and_stays_within_the_budget(strategy, parallel):
    total, trainer = 6_000, Walker()
    study = in_steps(total, strategy)
    run(study, trainer, parallel)
    bill = study.state.bill()
    assert bill.training + bill.extension == trainer.made["train"]
    assert bill.evaluation == trainer.made["play"]
    assert bill.total == sum(trainer.made.values())
    assert bill.failed == bill.under_way == 0.0
    assert bill.total <= total
    assert study.is_finished
    assert (bill.extension > 0.0) == (strategy in ("mixed", "one-policy"))


@pytest.mark.parametrize("parallel", [1, 2])
def test_the_last_steps_are_for_a_few_targets(parallel):
    each, row = 2 * EPISODE, N * 2 * EPISODE
    study, trainer = in_steps(2 * (UNIT + row) + UNIT + 3 * each + 1, "random"), Walker()
    run(study, trainer, parallel)
    counts = [int(np.isfinite(row.returns).sum()) for row in study.state.rows]
    assert sorted(counts) == [3, N, N]
    assert study.state.bill().total == study.spec.steps - 1
    assert study.is_finished
    assert "3 targets" not in (study.stop_reason or "")
    assert f"of the budget of {study.spec.steps:,} steps 1 are left" in study.stop_reason
    study.extend(mbtl.Steps(study.spec.steps + UNIT + row))
    assert not study.is_finished
    run(study, trainer)
    assert len(study.state.rows) == 4
    assert study.state.bill().total <= study.spec.steps


@pytest.mark.parametrize("strategy", ["all-first", "one-policy", "random"])
def test_whatever_is_left_at_the_end_a_study_ends(strategy):
    for total in range(1_150, 4_500, 633):
        study, trainer = in_steps(total, strategy), Walker()
        run(study, trainer)
        assert study.is_finished, total
        assert study.state.bill().total == sum(trainer.made.values())
        assert study.state.bill().total <= total + UNIT // 10  # a length is rounded up


@pytest.mark.parametrize("takes", [Walker.takes, Walker.takes - {"start"}])
def test_auto_trains_while_a_training_and_two_targets_can_be_paid(takes):
    target = EPISODE * EPISODES  # so an evaluation on all contexts costs two units
    for total in range(1_600, 9_000, 633):
        study, trainer = in_steps(total, "auto"), Walker()
        trainer.takes = takes
        study.equip(trainer)
        with pytest.raises(mbtl.StudyFinished):
            told(study, lambda source: np.full((N, EPISODES), 0.1 * source), 20)
        left = total - study.state.bill().total
        assert 0.0 <= left < 2 * target + UNIT * ("start" not in takes), total
        assert min(np.isfinite(row.returns).sum() for row in study.state.rows) >= 2


def test_it_is_said_once_that_evaluations_eat_most_of_the_budget(capsys):
    for targets, said in ((None, 1), (2, 0)):
        study = in_steps(6_000, "random", eval_targets=targets)
        for total in (6_000, 9_000):
            if total > study.spec.steps:
                study.extend(mbtl.Steps(total))
            run(study, Walker(), progress=True)
        words = "8 contexts may cost 2K steps, a training costs 1K: for more trainings, evaluate on"
        assert capsys.readouterr().err.count(words) == said


def test_steps_are_said_as_people_say_them():
    said = [counted(steps) for steps in (999.4, 999_499, 999_600, 1_250_000)]
    assert said == ["999", "999K", "1M", "1.25M"]


def test_a_budget_in_steps_is_raised_in_steps_and_only_raised():
    study = in_steps(5_000, "random")
    for wrong in (mbtl.Steps(5_000), 9, mbtl.Steps(10)):
        with pytest.raises(InvalidInput, match="can only be raised, and counts what it counted"):
            study.extend(wrong)
    with pytest.raises(InvalidInput, match="counts what it counted before"):
        created(SPACE, budget=3).extend(mbtl.Steps(10**6))
    study.extend(mbtl.Steps(7_000))
    assert (study.spec.steps, study.spec.budget) == (7_000, 7)


def test_failures_are_paid_each_try_of_them():
    trainer = Walker(breaks=lambda contexts, one: contexts[0]["x"] == 4.0 and one == 2)
    study = in_steps(20_000, "random")
    run(study, trainer, retries=1)
    bill = study.state.bill()
    assert [failure.source for failure in study.state.failures] == [4]
    assert bill.failed == 2 * 300  # the third tenth, twice
    assert bill.training + bill.failed == trainer.made["train"]
    trainer.breaks = None
    run(study, trainer, retry_failed=True)
    again = study.state.bill()
    assert again.failed == bill.failed  # that it is done at last gives nothing back
    assert again.training + again.failed == trainer.made["train"]
    study.void(0, "the simulator was misconfigured")
    assert study.state.bill().total == again.total
    trainer = Walker(breaks=lambda contexts, one: len(contexts) > 1 and one == 6)
    study = in_steps(3_000)  # of an extension what is beyond the 500 that are paid for, to 700
    run(study, trainer)
    bill = study.state.bill()
    assert bill.failed == 200
    assert bill.training + bill.extension + bill.failed == trainer.made["train"]


@pytest.mark.parametrize(
    ("given", "missing"),
    [
        ({}, "unit=<steps>, horizon=<steps>"),
        ({"horizon": EPISODE}, "unit=<steps>"),
        ({"unit": UNIT}, "horizon=<steps>"),
    ],
)
def test_functions_need_the_unit_and_the_longest_episode(given, missing):
    words = rf"give Steps\(5000, {missing}\) in Python, for `mbtl run --steps` goes by the problem"
    with pytest.raises(InvalidInput, match=words):
        created(SPACE, budget=mbtl.Steps(5_000, **given))


def test_steps_are_a_number():
    with pytest.raises(InvalidInput, match="total of Steps must be a whole number, got None"):
        mbtl.Steps(None, unit=UNIT, horizon=EPISODE)


def test_functions_are_paid_by_their_reports_or_by_units():
    def train(contexts, seed, *, start=None, length=None, on_progress=None):
        if on_progress is not None and len(contexts) > 1:
            on_progress(Progress(round(900 * length), 1_000))  # of this call
        return {"home": 3.0, "wide": 8, "length": length}

    walker, study = Walker(), in_steps(60_000)
    ran(study, train, walker.evaluate, report=False)
    longer = [row for row in study.state.rows if row.done]
    assert [row.steps for row in longer] == pytest.approx(
        [450 + 360 * (i + 1) for i in range(len(longer))]
    )
    bill = study.state.bill()
    assert bill.extension == pytest.approx(360 * len(longer))
    alone = [row for row in study.state.rows if len(row.sources) == 1]
    assert bill.training == pytest.approx(450 + 300 * len(alone))  # nothing was reported: 0.3 units
    assert bill.evaluation == len(study.state.rows) * N * 2 * EPISODE  # each the longest
    assert study.stop_reason == "every context had its turn"


def test_an_evaluation_costs_the_episodes_that_it_returned():
    study, row = in_steps(60_000, "random"), np.full((N, 20), 0.5)
    assert study.state.target_steps == EPISODES * EPISODE  # nobody knows so far
    row[0, 3:] = np.nan  # seventeen broke off
    for returns, episodes in ((row[:, :3], 3 * N), (row[:, 0], N), (row, 20 * N - 17)):
        before = study.state.bill()
        study.tell(study.ask(), returns)
        bill = study.state.bill()
        assert bill.evaluation - before.evaluation == episodes * EPISODE
        assert bill.training - before.training == UNIT
    assert study.state.target_steps == bill.evaluation / (3 * N)


def test_further_evaluations_are_paid_once_and_change_no_price():
    class Further:
        name, traits = "further", Traits(any_training=True)

        def propose(self, problem, history, rng):
            if not len(history):
                return Proposal(3, "all", length=1.0, sources=ALL, targets=(0, 7))
            missing = np.flatnonzero(np.isnan(history.rows[0]))
            if not missing.size:
                raise Exhausted("that is all")
            targets = tuple(missing[:2].tolist())
            return Proposal(3, "further", start=0, length=0.0, sources=ALL, targets=targets)

    trainer, study = Walker(), in_steps(10_000, Further())
    run(study, trainer)
    assert study.stop_reason == "that is all"
    assert study.is_finished
    (row,) = study.state.rows
    truth = trainer.evaluate(study.portfolio(trainer).policy(0), SPACE.contexts, [0] * N)
    np.testing.assert_allclose(row.returns, truth.mean(axis=1))
    assert [pick.price for pick in study.state.picks] == [1.0, 0.0, 0.0, 0.0]
    trainer.made["play"] //= 2  # the truth was played, too
    assert study.state.bill().evaluation == trainer.made["play"] == N * 2 * EPISODE
    assert study.state.target_steps == 2 * EPISODE
    assert [one.state for one in study.trainings] == ["done"] * 4


def test_a_further_evaluation_that_cannot_be_made_is_given_up_on_request():
    """It trains nothing, so there is nothing to begin again."""
    simulator = Simulator()

    def evaluate(policy, contexts, seeds):
        if len(contexts) == N - 2:
            raise RuntimeError("no display")
        return simulator.evaluate(policy, contexts, seeds)

    first = replace(EVERYBODY, targets=(0, 7))
    more = replace(EVERYBODY, start=0, length=0.0, targets=tuple(range(1, 7)))
    study = study_of(Scripted((first, more)))
    for retry in (False, True):
        ran(study, simulator.train, evaluate, report=False, retry_failed=retry)
        assert (len(study.state.deferred), len(study.state.failures)) == (1 - retry, int(retry))
    assert len(simulator.calls) == 1
    assert not study.state.open_picks


# ---- the state of a training --------------------------------------------------------------------


def weights_of(study, trainer, length):
    row = next(row for row in study.state.rows if row.length == length)
    return trainer.load(study.artifacts.read(row.policy, row.sha256))["weight"]


@pytest.mark.parametrize(
    ("artifacts", "lost"),
    [(None, "nothing"), (None, "state"), (None, "changed"), ("memory://test-budget", "nothing")],
)
def test_a_training_goes_on_exactly_or_with_its_weights(tmp_path, artifacts, lost):
    if artifacts is not None:
        pytest.importorskip("fsspec")
    settings = {"storage": tmp_path / "s.db", "artifacts": artifacts}
    trainer = Walker()
    run(created(SPACE, budget=1, strategy="one-policy", **settings), trainer)
    study = mbtl.load_study(**settings)
    (row,) = study.state.rows
    assert row.state is not None
    file = study.artifacts.read(row.state) / "state"
    if lost == "state":
        file.unlink()
    elif lost == "changed":
        file.write_text(json.dumps([3, 1e9, 1e9]))
    study.extend(2)
    run(study, trainer)
    assert trainer.begun == ["scratch", "state" if lost == "nothing" else "weights"]
    at_once = trainer.train(SPACE.contexts, study.pick(0).seed, length=2.0).policy["weight"]
    found = weights_of(study, trainer, 2.0)
    assert (found == at_once) == (lost == "nothing")
    second = study.state.rows[1]
    assert second.steps == 2 * UNIT
    assert study.pick(0).seed == study.pick(1).seed
    if lost != "nothing":  # from its weights, the momentum is gone
        momentum = [10.0 * (1.0 - 0.9 ** (i + 1)) for i in range(10)]
        assert found == pytest.approx(weights_of(study, trainer, 1.0) + sum(momentum))


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_a_policy_that_was_not_evaluated_keeps_its_bill_and_its_state(tmp_path, error):
    trainer = Walker()
    run(created(SPACE, budget=1, strategy="one-policy", storage=tmp_path / "s.db"), trainer)

    def fails():
        raise error("no display")

    study = mbtl.load_study(tmp_path / "s.db")
    study.extend(2)
    with pytest.raises((KeyboardInterrupt, TrainingFailed)):
        run(study, Walker(looks=fails), stop_after_failures=1)
    assert len(study.refresh().deferred) == (error is RuntimeError)
    again = mbtl.load_study(tmp_path / "s.db")
    run(again, trainer)
    row = again.state.rows[1]
    assert (row.length, row.steps) == (2.0, 2 * UNIT)
    assert not again.state.deferred
    again.extend(4)
    run(again, trainer)
    assert trainer.begun == ["scratch", "state"]  # and not trained again meanwhile
    whole = trainer.train(SPACE.contexts, again.pick(0).seed, length=4.0).policy["weight"]
    assert weights_of(again, trainer, 4.0) == whole


# ---- costs --------------------------------------------------------------------------------------


def test_a_cost_pays_for_lengths_and_for_the_mean_of_a_set():
    costs = np.arange(1.0, N + 1.0)
    budget = mbtl.Cost(11.0, costs, trainings=6)
    study = mbtl.create_study(SPACE, budget=budget, strategy=Mixed())
    run(study, Walker())
    assert [row.cost for row in study.state.rows][:2] == [0.5 * 4.5, 0.3 * costs[0]]
    assert study.state.cost == pytest.approx(
        sum(pick.price * costs[list(pick.sources)].mean() for pick in study.state.picks)
    )
    assert study.state.committed <= 11.0
    assert study.is_finished
    assert study.stop_reason.startswith("of the cost budget of 11 ")


def test_each_try_of_a_training_is_paid_where_costs_are_known():
    study = mbtl.create_study(SPACE, budget=mbtl.Cost(4.0, np.ones(N)), strategy="kmeans")
    pick = study.ask()
    study.fail(pick, "by chance", again=True)
    assert (study.state.committed, study.state.spent_words(answered=True)) == (2, "cost 1 of 4")
    study.tell(study.ask(), np.full(N, 0.5))
    study.fail(study.ask(), "for good")
    assert (study.state.cost, study.state.committed) == (1, 3)
    assert study.state.cost_left == pytest.approx(1)
    assert study.ask() is not None
    with pytest.raises(StudyFinished):
        study.ask()


@pytest.mark.parametrize("total", [1.0, 3.0])
def test_a_try_that_the_cost_no_longer_pays_for_is_made_all_the_same_as_in_steps(total):
    tries = []

    def train(context, seed):
        tries.append(seed)
        if len(tries) == total:
            raise RuntimeError("by chance")
        return 0.5

    trainer = mbtl.trainers.FunctionTrainer(train, lambda policy, contexts: [policy] * N)
    study = mbtl.create_study(SPACE, budget=mbtl.Cost(total, np.ones(N)), strategy="kmeans")
    run(study, trainer, retries=1)
    assert (len(study.state.rows), study.state.open_picks) == (total, {})
    assert study.state.spent_words() == f"cost {total + 1:g} of {total:g}"


def test_what_is_under_way_counts_where_costs_are_only_told():
    study = mbtl.create_study(SPACE, budget=mbtl.Cost(3.5), strategy="all-first")
    study.equip(mbtl.trainers.FunctionTrainer(Simulator().train, Simulator().evaluate))
    study.tell(study.ask(), np.full(N, 0.5), cost=1.0)
    assert study.state.units_left == 2.5
    study.ask(2)
    assert study.state.units_left == 0.5


@pytest.mark.parametrize("strategy", ["equidistant", "kmeans"])
def test_selectors_spread_their_picks_by_what_the_budget_pays_for(strategy):
    # evaluated on eight targets, ten times each, the last one on two; one context is out of reach
    steps = mbtl.Steps(2 * (1000 + 8 * 300) + 1000 + 2 * 300, unit=1000, horizon=30)
    budgets = (3, mbtl.Cost(6.0, [*np.full(N - 1, 2.0), 20.0]), steps)
    picked = [
        [pick.source for pick in mbtl.create_study(SPACE, budget=one, strategy=strategy).ask(2)]
        for one in budgets
    ]
    assert picked[0] == picked[1] == picked[2]
    assert len(set(picked[0])) == 2


def test_one_target_is_too_few_to_know_anything_of_elsewhere():
    with pytest.raises(InvalidInput, match="on 2 to 8 targets, got 1"):
        mbtl.create_study(SPACE, budget=3, evaluation=mbtl.Evaluation(1))


@pytest.mark.parametrize("strategy", ["auto", "one-policy"])
@pytest.mark.parametrize("costs", [np.arange(1.0, N + 1.0), None])
def test_the_cost_ends_a_study_not_the_usual_number_of_trainings(strategy, costs, capsys):
    simulator = Simulator()
    problem = mbtl.CMDP.from_functions(
        "dear", SPACE, train=simulator.train, evaluate=simulator.evaluate, budget=3, bounds=(0, 1)
    )
    study = problem.study(budget=mbtl.Cost(31.5, costs), strategy=strategy)
    study.run(report=False)
    assert study.state.cost == pytest.approx(31.5)
    assert "policies told, cost 31.5 of 31.5, " in repr(study)
    first = study.state.rows[0].cost
    assert f"pick 1, cost {first:g} of 31.5: all contexts" in capsys.readouterr().err
    summary = summarise_study(study)
    assert (summary.size, summary.cost) == ("cost 31.5", study.state.cost)
    assert "Spent: cost 31.5 of 31.5." in lines(summary, SPACE)
    assert of_study(study).provenance["budget"] == "cost 31.5"
    assert problem.study(budget=mbtl.Cost(31.5), strategy="random").spec.budget == 3
