"""Auto over trainings: worlds in closed form, and live studies."""

from dataclasses import replace

import numpy as np
import pytest

import mbtl
import transfer_worlds
from flat import created, ran
from mbtl.history import History, Training
from mbtl.selectors import Exhausted, get_selector
from mbtl.strategies import OnePolicy
from mbtl.strategies.auto import Auto
from mbtl.study import StudyWaiting
from mbtl.zoo.benchmark.trainings import TransferWorld, replay_trainings

N = 9
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): N})
ALL = tuple(range(N))


def run(data, strategy, budget=15):
    return replay_trainings(strategy, TransferWorld(data, 0), budget)


# ---- worlds in closed form ----------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_where_one_policy_suffices_nearly_all_units_go_into_it(noise):
    data = transfer_worlds.one_policy_suffices(noise=noise)
    for budget in (1, 2, 4, 8):
        auto, one = run(data, Auto(), budget), run(data, OnePolicy(), budget)
        assert auto.at(budget) > one.at(budget) - 0.01


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_where_one_policy_for_all_fails_specialists_take_over_soon(noise):
    data = transfer_worlds.one_for_all_fails(noise=noise)
    found, alone = run(data, Auto()), run(data, get_selector("specialists"))
    assert found.at(3) > alone.at(2) - 0.01  # one unit shows it
    for budget in range(3, 16):
        assert found.at(budget) > alone.at(budget - 1) - 0.01 - 0.2 * noise  # luck of a pick
    contexts = [len(one.contexts) for one in found.trainings]
    assert contexts.count(1) >= 10
    assert len(contexts) - contexts.count(1) == 2


def test_a_policy_for_all_that_stays_as_it_was_is_not_trained_longer():
    """The best of its evaluations is early: what is usual of doublings is not to be hoped for."""
    stays = transfer_worlds.transfers(
        lambda units, x: 0.6 - 0.1 * np.abs(x - 0.5),
        transfer_worlds.bump(0.02, 0.2), transfer_worlds.bump(0.62, 0.05), noise=0.05,
    )  # fmt: skip
    same = stays.generalists[0.5]
    data = replace(stays, generalists=dict.fromkeys(stays.generalists, same))
    assert [len(one.contexts) for one in run(data, Auto()).trainings].count(1) >= 13


# ---- live ---------------------------------------------------------------------------------------


class Simulator:
    """A policy is a row and its units; one for all learns slowly, a specialist fast at home."""

    def __init__(self, slow=0.5, home=0.4):
        self.slow, self.home, self.calls = slow, home, []

    def train(self, contexts, seed, *, start=None, length=None):
        units = 1.0 if length is None else length
        at = np.array([context["x"] for context in contexts])
        self.calls.append((len(at), None if start is None else start["units"], units))
        before = start or {"units": 0.0, "for_all": 0.0, "row": np.zeros(N)}
        x = np.linspace(0.0, 1.0, N)
        if len(at) > 1:
            done = before["for_all"] + units
            row = np.full(N, 0.6 * done / (done + self.slow))
            return {"units": before["units"] + units, "for_all": done, "row": row}
        bump = self.home * min(units, 1.0) * np.maximum(1.0 - np.abs(x - at[0]) / 0.2, 0.0)
        return {**before, "units": before["units"] + units, "row": before["row"] + bump}

    def evaluate(self, policy, contexts, seeds):
        return [policy["row"][round(context["x"] * (N - 1))] for context in contexts]


def test_a_live_study_says_in_each_line_what_is_trained_and_why():
    simulator = Simulator(slow=0.1)
    study = created(SPACE, budget=8, strategy=Auto(), bounds=(0.0, 1.0))
    study.run(simulator.train, simulator.evaluate, progress=False)
    reasons = [pick.reason for pick in study.state.picks]
    assert reasons[0] == "all contexts first"
    assert reasons[1] == "all contexts, longer"
    assert reasons[2] == "all contexts, longer: the last doubling added 0.045"
    assert any(reason.startswith("from scratch: ") for reason in reasons)
    assert study.state.paid == pytest.approx(8.0)
    assert study.value > 0.55


def test_a_trainer_of_one_context_gets_what_the_chooser_says_and_one_sentence():
    simulator = Simulator()
    study, alone = (
        created(SPACE, budget=4, strategy=s, bounds=(0.0, 1.0)) for s in (Auto(), "specialists")
    )
    for one in (study, alone):
        one.run(lambda context, seed: simulator.train([context], seed), simulator.evaluate,
                progress=False)  # fmt: skip
    assert [p.sources for p in study.state.picks] == [p.sources for p in alone.state.picks]
    (note,), *others = [pick.notes for pick in study.state.picks]
    assert note.startswith("this trainer takes one context at a time, so no policy for several")
    assert others == [()] * 3


def test_whoever_trains_by_hand_is_asked_for_one_context_until_a_trainer_is_known():
    """Else `train(pick.context)` would be told as a policy for all of them."""
    simulator = Simulator()
    study = created(SPACE, budget=4, strategy="auto", bounds=(0.0, 1.0))
    assert study.spec.selector["name"] == "auto"
    by_hand = study.ask()
    assert (len(by_hand.sources), by_hand.start, by_hand.length) == (1, None, None)
    (note,) = study.state.picks[0].notes
    assert "no trainer is known so far" in note
    made = simulator.train([by_hand.context], by_hand.seed)
    study.tell(by_hand, simulator.evaluate(made, SPACE.contexts, None))
    trainer = mbtl.trainers.FunctionTrainer(simulator.train, simulator.evaluate)
    study.equip(trainer)
    first = study.ask()
    assert first.sources == tuple(range(SPACE.n))
    with pytest.raises(StudyWaiting, match=r"until one of the 1 picks .*: what is best next"):
        study.ask()
    assert not study.is_finished
    study.tell(first, np.full(N, 0.3))
    assert study.ask().start is not None
    with pytest.warns(mbtl.errors.Notice, match="no trainer is known so far"):  # that it uses
        mbtl.CMDP("mine", SPACE, trainer).study(budget=4).ask()


def test_what_a_trainer_cannot_do_is_said_once(capsys):
    simulator = Simulator()
    study = created(SPACE, budget=3, strategy=Auto(), bounds=(0.0, 1.0))
    study.run(lambda context, seed: simulator.train([context], seed), simulator.evaluate)
    printed = capsys.readouterr()
    assert (printed.out + printed.err).count("this trainer takes one context at a time") == 1


def test_a_trainer_without_start_is_asked_for_no_copy_and_nothing_longer():
    simulator = Simulator()
    study = created(SPACE, budget=4, strategy=Auto(), bounds=(0.0, 1.0))
    study.run(lambda contexts, seed: simulator.train(contexts, seed), simulator.evaluate,
              progress=False)  # fmt: skip
    assert [len(pick.sources) for pick in study.state.picks] == [N, 1, 1, 1]
    sentence = "this trainer takes no start, so no policy is tuned or trained longer; "
    sentence += "train(contexts, seed, *, start=None, length=None) can do both"
    assert [pick.notes for pick in study.state.picks] == [(sentence,), (), (), ()]


def test_two_workers_spend_the_budget_and_end_as_well():
    values = []
    for parallel in (1, 2):
        study, simulator = created(SPACE, budget=6, strategy=Auto(), bounds=(0.0, 1.0)), Simulator()
        ran(study, simulator.train, simulator.evaluate, threads=parallel, report=False)
        assert study.state.paid == pytest.approx(6.0)
        assert [len(pick.sources) for pick in study.state.picks[:2]] == [N, N]
        values.append(study.value)
    assert values[1] > values[0] - 0.05


def test_a_study_ends_when_no_training_is_likely_to_gain_what_was_asked_for():
    simulator = Simulator(slow=0.05, home=0.0)  # .57 after a unit, and then hardly more
    study = created(SPACE, budget=15, strategy=Auto(), bounds=(0.0, 1.0), stop_left=0.05)
    study.run(simulator.train, simulator.evaluate, progress=False)
    assert "gain less than 0.05" in study.stop_reason
    assert study.state.paid < 8.0


# ---- what is known at a pick --------------------------------------------------------------------


def problem(budget=8, abilities=("sets", "start", "length"), **wishes):
    return mbtl.selectors.SelectionProblem.of(
        SPACE, budget=budget, abilities=frozenset(abilities), **wishes
    )


def told(*trainings, rows, **more):
    middle = [4 if len(one.contexts) > 1 else one.contexts[0] for one in trainings]
    paid = sum(
        one.length - (trainings[one.start].length if one.goes_on else 0.0) for one in trainings
    )
    return History(
        N, tuple(middle), np.array(rows, dtype=float), trainings=trainings, paid=paid, **more
    )


HALF, WHOLE = Training(ALL, None, 0.5), Training(ALL, 0, 1.0, goes_on=True)
VAIN = HALF, Training(ALL, None, 0.25)
SLOW = [np.full(N, 0.40), np.full(N, 0.41)]
RNG = np.random.default_rng(0)


def test_another_worker_waits_for_the_first_policy_and_then_does_something_else():
    with pytest.raises(Exhausted, match="in training now"):
        Auto().propose(problem(), History(N, under_way=(HALF,), paid=0.5), RNG)
    longer = Training(ALL, 1, 2.0, goes_on=True)
    fast = told(HALF, WHOLE, rows=[np.full(N, 0.3), np.full(N, 0.5)])
    assert Auto().propose(problem(), fast, RNG).contexts == ALL
    busy = replace(fast, under_way=(longer,), paid=2.0)
    assert len(Auto().propose(problem(), busy, RNG).contexts) == 1


def test_what_crashed_once_is_tried_for_half_as_long_and_no_third_time():
    once, twice = (Training(ALL, 1, length, goes_on=True) for length in (2.0, 1.5))
    fast = told(HALF, WHOLE, rows=[np.full(N, 0.3), np.full(N, 0.5)])
    found = Auto().propose(problem(), replace(fast, given_up=(once,), paid=2.0), RNG)
    assert (found.contexts, found.start, found.length) == (ALL, 1, 1.5)
    assert "gave nothing: half as much" in found.notes[0]
    longer = Training(ALL, 1, 1.5, goes_on=True)
    slower = told(HALF, WHOLE, longer, rows=[np.full(N, at) for at in (0.3, 0.5, 0.55)])
    assert "the last 0.5 units added 0.050" in Auto().propose(problem(), slower, RNG).reason
    late = replace(fast, given_up=(Training(ALL, 1, 1.5, goes_on=True),), paid=1.5)  # and extended
    assert Auto().propose(problem(), late, RNG).length == 1.25
    found = Auto().propose(problem(), replace(fast, given_up=(once, twice), paid=2.5), RNG)
    assert len(found.contexts) == 1


def test_half_a_unit_that_is_left_of_a_failed_one_ends_the_study():
    half = History(N, given_up=VAIN, failed=(1, 2, 3), paid=14.5)
    with pytest.raises(Exhausted, match="less left than a whole training"):
        Auto().propose(problem(budget=15), half, RNG)
    cheap = problem(budget=15, costs=np.full(N, 0.1), cost_budget=10.0)
    assert len(Auto().propose(cheap, half, RNG).contexts) == 1


def test_a_policy_for_all_that_failed_is_tried_for_half_as_long_and_then_leaves_the_chooser():
    once = History(N, given_up=(HALF,), paid=0.5)
    found = Auto().propose(problem(), once, RNG)
    assert (found.contexts, found.start, found.length) == (ALL, None, 0.25)
    assert "gave nothing: half as long" in found.notes[0]
    whole_only = replace(problem(), abilities=frozenset({"sets"}))  # no other length can be asked
    assert len(Auto().propose(whole_only, once, RNG).contexts) == 1
    found = Auto().propose(problem(), History(N, given_up=VAIN, paid=0.75), RNG)
    assert (found.contexts, found.start) == ((4,), None)


def test_one_small_doubling_after_a_large_one_does_not_end_the_policy_for_all():
    trainings = HALF, WHOLE, Training(ALL, 1, 2.0, goes_on=True), Training((4,), None, 1.0)
    alone = np.where(np.arange(N) == 4, 0.7, 0.0)  # adds .02 to V
    for first, trained_on in ((0.3, N), (0.5, 1)):
        rows = [*(np.full(N, at) for at in (first, 0.5, 0.5)), alone]
        found = Auto().propose(problem(), told(*trainings, rows=rows), RNG)
        assert len(found.contexts) == trained_on
    history = told(*trainings, rows=[*(np.full(N, at) for at in (0.3, 0.5, 0.5)), alone / 2.0])
    unsure = Auto().propose(replace(problem(), least_left=0.05), history, RNG)
    assert 0.5 < unsure.chance_left < 0.95


def test_unevaluated_targets_are_filled_in():
    rows = [row.copy() for row in SLOW]
    rows[1][::2] = np.nan
    found = Auto().propose(problem(), told(HALF, WHOLE, rows=rows), RNG)
    assert len(found.contexts) == 1


def test_dear_contexts_are_trained_last():
    costs = np.ones(N)
    costs[4:] = 50.0
    alone = Training((2,), None, 1.0)
    row = np.maximum(0.9 - np.abs(np.arange(N) - 2) / 4.0, 0.0)
    history = told(HALF, WHOLE, alone, rows=[*SLOW, row])
    found = Auto().propose(problem(costs=costs, cost_budget=1000.0), history, RNG)
    assert found.contexts[0] < 4
