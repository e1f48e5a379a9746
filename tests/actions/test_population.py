"""Population: who is given up, whose weights are copied where, and in what order."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from line_of_nine import PROBLEM, STEPS, N

from mbtl.actions import (
    Committee,
    Evaluate,
    Evaluation,
    Extend,
    Policy,
    Population,
    Start,
    StartOn,
    Stop,
    Training,
)
from mbtl.actions.base import Trail
from mbtl.actions.population import missed_without
from mbtl.errors import InvalidInput

RNG = np.random.default_rng(0)
EVERYWHERE = Evaluation()


def people(size=3, **settings):
    return Population(size, selector=None, evaluation=EVERYWHERE, **settings)


def tent(source, level):
    """A row that falls by 0.1 per step of the line."""
    return level - 0.1 * np.abs(np.arange(N) - source)


def seen(trail, training, length, row):
    at = np.arange(N)
    return trail.with_evaluation(Policy(training, length), at, np.asarray(row, dtype=float), 10.0)


def with_members(*rows, sources=(4, 0, 8), ended=()):
    """A first round: trainings at their first mark, evaluated everywhere."""
    made = Trail(STEPS)
    for j, (source, row) in enumerate(zip(sources, rows, strict=True)):
        made = made.with_training(j, Training(source, 0, 100, j in ended), 100.0)
        made = seen(made, j, 0, row)
    return made


class Adds:
    """A world where a training lifts the row it begins with by a thousandth per step, all over."""

    def __init__(self, ends_at=np.inf):
        self.ends_at = ends_at

    def row(self, trail, training):
        now = trail.trainings[training]
        begun = 0.0 if now.start is None else self.row(trail, now.start.training)[now.start.length]
        return begun + np.minimum(PROBLEM.lengths, self.ends_at) / 1_000

    def act(self, trail, action):
        match action:
            case Start(source, length, start):
                steps = int(PROBLEM.lengths[length])
                ended = self.ends_at <= steps
                now = Training(source, length, steps, ended, start=start)
                return trail.with_training(len(trail.trainings), now, float(steps))
            case Extend(training, length):
                now = trail.trainings[training]
                steps = int(PROBLEM.lengths[length])
                longer = replace(now, length=length, steps=steps, ended=self.ends_at <= steps)
                return trail.with_training(training, longer, float(steps - now.steps))
            case Evaluate(policy, targets):
                value = self.row(trail, policy.training)[policy.length]
                found = np.full(len(targets), value)
                return trail.with_evaluation(policy, np.array(targets), found, 0.0)
        raise AssertionError(action)


def played(strategy, world, most=1_000):
    """The trails after each action until it stops, and the actions."""
    trails, actions = [Trail(STEPS)], []
    while len(actions) < most:
        action = strategy.decide(PROBLEM, trails[-1], RNG)
        if action == Stop():
            break
        trails.append(world.act(trails[-1], action))
        actions.append(action)
    return trails, actions


def test_the_first_members_are_from_scratch_and_a_quarter_long():
    _, actions = played(people(), Adds(), most=6)
    assert [a for a in actions if isinstance(a, Start)] == [Start(4, 0), Start(0, 0), Start(8, 0)]
    two = replace(PROBLEM, lengths=np.array([200, 400]))  # no quarter: the shortest there is
    assert people().decide(two, Trail(STEPS), RNG) == Start(4, 0)
    assert people(length=-1).decide(PROBLEM, Trail(STEPS), RNG) == Start(4, 2)


def test_a_member_is_worth_what_v_would_lose_without_all_of_its_policies():
    trail = with_members(tent(4, 0.5), tent(0, 0.5), tent(8, 0.5))
    worth = missed_without(PROBLEM, trail, trail.policies)
    # the middle one is ahead by 0.2, 0.4 and 0.2 on three contexts; an outer one by 0.4 and 0.2
    assert [worth[j][0] for j in range(3)] == pytest.approx([0.8 / 9, 0.6 / 9, 0.6 / 9])
    assert [worth[j][1] for j in (0, 1)] == pytest.approx([0.5 - 2.0 / 9, 0.1])
    longer = trail.with_training(1, Training(0, 1, 200), 100.0)
    longer = seen(longer, 1, 1, tent(0, 0.6))  # its earlier self is no substitute
    worth = missed_without(PROBLEM, longer, longer.policies)
    assert worth[1][0] == pytest.approx((0.5 + 0.3 + 0.1) / 9)
    assert missed_without(PROBLEM, longer, longer.policies[:3])[1][0] == pytest.approx(0.6 / 9)
    worse = seen(trail.with_training(1, Training(0, 1, 200), 100.0), 1, 1, tent(0, 0.1))
    assert missed_without(PROBLEM, worse, worse.policies)[1][0] == pytest.approx(0.6 / 9)


def test_the_others_go_on_and_a_copy_takes_the_place_of_whom_v_misses_least():
    trail, strategy = with_members(tent(4, 0.5), tent(0, 0.45), tent(8, 0.6)), people()
    assert strategy.decide(PROBLEM, trail, RNG) == Extend(0, 1)
    trail = trail.with_training(0, Training(4, 1, 200), 100.0)
    now_best = seen(trail, 0, 1, tent(8, 0.9))  # better than training 2 all over: the plan stays
    assert strategy.decide(PROBLEM, now_best, RNG) == Extend(2, 1)
    trail = seen(trail, 0, 1, tent(4, 0.3))  # it got worse
    assert strategy.decide(PROBLEM, trail, RNG) == Extend(2, 1)
    trail = trail.with_training(2, Training(8, 1, 200), 100.0)
    trail = seen(trail, 2, 1, tent(8, 0.61))
    # context 2 is the first one in the middle of the largest stretch; the first mark of training 0
    # serves it with 0.3, training 1 with 0.25
    assert strategy.decide(PROBLEM, trail, RNG) == Start(2, 0, Policy(0, 0))


def test_an_own_return_counts_for_nothing():
    """Nor does a mean: of three the first is good at home and everywhere, but so is the second.

    The third one is worst at home and on average, and alone on one context.
    """
    poor = np.full(N, -1.0)
    poor[2] = 1.0
    trail = with_members(np.full(N, 0.9), np.full(N, 0.95), poor)
    strategy = people()
    assert strategy.staying(PROBLEM, trail, 3, 3) == [1, 2]
    assert strategy.decide(PROBLEM, trail, RNG) == Extend(1, 1)


def test_of_members_that_add_nothing_the_worst_on_average_goes_and_of_equals_the_last():
    trail = with_members(np.full(N, 0.9), np.full(N, 0.1), np.full(N, 0.2))
    assert people().staying(PROBLEM, trail, 3, 3) == [0, 2]
    trail = with_members(np.full(N, 0.9), np.full(N, 0.1), np.full(N, 0.1))
    assert people().staying(PROBLEM, trail, 3, 3) == [0, 1]


def test_a_share_of_them_is_given_up_and_one_at_least():
    rows = [tent(s, 0.5 + 0.1 * s) for s in range(5)]
    trail = with_members(*rows, sources=range(5))  # each is worth less than the one after it
    for share, left in ((0.01, 4), (0.2, 4), (0.4, 3), (0.6, 2)):
        assert people(5, truncation=share).staying(PROBLEM, trail, 5, 5) == [*range(5 - left, 5)]


def test_where_weights_carry_over_v_rises_by_as_much_in_every_round():
    """Two members: the copy begins where the other one ends, so V = 0.1 (1 + 2 r) after round r.

    A training from scratch comes to 0.4 here, however many there are.
    """
    trails, actions = played(people(2), Adds())
    value = {}
    for trail in trails:
        if trail.policies and len(trail.policies) % 2 == 0 and trail.unevaluated is None:
            value[len(trail.policies) // 2 - 1] = (trail.filled.max(), trail.spent)
    for r in range(7):
        assert value[r] == (pytest.approx(0.1 * (1 + 2 * r)), 200 * (1 + r))
    starts = [a.start for a in actions if isinstance(a, Start)]
    assert starts[:5] == [None, None, Policy(0, 1), Policy(2, 1), Policy(3, 1)]


def test_in_every_round_each_member_has_one_piece():
    trails, _ = played(people(3), Adds())
    policies = trails[-1].policies
    rounds = [policies[i : i + 3] for i in range(0, 3 * (N // 2), 3)]
    for before, after in pairwise(rounds):
        had = [policy.training for policy in after]
        assert len(set(had)) == 3
        old = {policy.training for policy in before} & set(had)
        assert len(old) <= 2  # one is given up at least
        assert all(j > max(p.training for p in before) for j in set(had) - old)


def test_who_has_reached_the_end_leaves_a_place_and_stays_in_the_portfolio():
    trail = with_members(tent(4, 0.9), tent(0, 0.8), tent(8, 0.5), ended=(0,))
    strategy = people()
    assert strategy.staying(PROBLEM, trail, 3, 3) == [1]
    assert strategy.decide(PROBLEM, trail, RNG) == Extend(1, 1)
    trail = trail.with_training(1, Training(0, 1, 200), 100.0)
    trail = seen(trail, 1, 1, tent(0, 0.8))
    first = strategy.decide(PROBLEM, trail, RNG)
    assert first == Start(2, 0, Policy(0, 0))  # 0.7 from the one that has ended, 0.6 from the other
    trail = trail.with_training(3, Training(2, 0, 100, start=first.start), 100.0)
    trail = seen(trail, 3, 0, tent(2, 0.95))
    assert strategy.decide(PROBLEM, trail, RNG) == Start(6, 0, Policy(0, 0))
    all_ended, actions = played(people(2), Adds(ends_at=100))
    assert not any(isinstance(a, Extend) for a in actions)
    assert [t.source for t in all_ended[-1].trainings] == [4, 0, 8, 2, 6, 1, 3, 5, 7]


def test_where_no_context_is_left_those_go_on_that_v_would_miss_then_it_stops():
    trails, actions = played(people(4), Adds())
    end = trails[-1]
    assert sorted(t.source for t in end.trainings) == list(range(N))
    assert all(t.length == 2 for t in end.trainings)
    assert people(4).decide(PROBLEM, end, RNG) == Stop()
    last_start = max(i for i, a in enumerate(actions) if isinstance(a, Start))
    assert all(isinstance(a, Extend | Evaluate) for a in actions[last_start + 1 :])
    rows = [tent(s, 1.0 if s == 3 else 0.5) for s in range(N)]
    trail = with_members(*rows, sources=range(N), ended=(6, 7))
    assert people(2).decide(PROBLEM, trail, RNG) == Extend(3, 1)  # its last members have ended


def test_there_are_no_more_members_than_contexts():
    trails, _ = played(people(50), Adds(), most=2 * N + 4)
    assert len(trails[-1].trainings) == N
    assert [t.length for t in trails[-1].trainings[:3]] == [1, 1, 0]  # the second round has begun


def test_it_decides_by_the_trail_alone():
    strategy = people(3)
    trails, actions = played(strategy, Adds())
    for trail, action in zip(trails, actions, strict=False):
        assert people(3).decide(PROBLEM, trail, np.random.default_rng(9)) == action
    by_mbtl = Population(3, evaluation=EVERYWHERE)
    ones, others = (played(by_mbtl, Adds())[1] for _ in range(2))
    assert ones == others
    assert any(isinstance(a, Start) and a.start is not None for a in ones)


def test_it_decides_by_what_came_before_so_workers_take_turns():
    assert Population.starts_warm
    assert not getattr(Population, "in_parallel", False)


def test_as_specialists_of_a_committee_it_copies_from_its_own_side():
    costly = replace(PROBLEM, lengths_on_all=np.array([50, 10_000]))
    both, every = Committee(people(2)), tuple(range(N))
    assert both.starts_warm
    trail = Trail(STEPS).with_training(0, Training(4, 0, 50, True, every), 50.0)
    trail = seen(trail, 0, 0, np.full(N, 0.9))
    for j, row in ((1, tent(4, 0.5)), (2, tent(0, 0.4))):
        trail = trail.with_training(j, Training((0, 4, 0)[j], 0, 100), 100.0)
        trail = seen(trail, j, 0, row)
    assert both.decide(costly, trail, RNG) == Extend(1, 1)
    trail = trail.with_training(1, Training(4, 1, 200), 100.0)
    trail = seen(trail, 1, 1, tent(4, 0.6))
    action = both.decide(costly, trail, RNG)
    assert not isinstance(action, StartOn)
    assert action == Start(8, 0, Policy(1, 1))


@pytest.mark.parametrize("given", [{"size": 1}, {"truncation": 0.0}, {"truncation": 1.0}])
def test_numbers_that_mean_nothing_are_refused(given):
    with pytest.raises(InvalidInput, match="two members or more"):
        Population(**given)


def test_it_holds_out_the_family_it_is_judged_on():
    from mbtl.models.priors import prior_without

    held = Population(selector="auto").without("cartpole")
    assert held.selector.prior == prior_without("cartpole")
    assert people().without("cartpole") == people()
