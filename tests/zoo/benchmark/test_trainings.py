"""Replay of strategies on transfer data: what is asked for is rounded, charged and answered."""

from dataclasses import replace

import numpy as np
import pytest

import mbtl
import transfer_worlds
from mbtl.errors import InvalidInput, MbtlError
from mbtl.history import Training
from mbtl.models.priors import PRIORS
from mbtl.selectors import Proposal, get_selector
from mbtl.strategies import AllFirst
from mbtl.zoo.benchmark.base import measured_curve
from mbtl.zoo.benchmark.replay import replay
from mbtl.zoo.benchmark.trainings import ABILITIES, TransferWorld, replay_trainings, specialists_of
from scripted import Scripted

DATA = transfer_worlds.tuning_pays()
ALL = tuple(DATA.sources.tolist())
X = DATA.space.unit[:, 0]


def asked(*script, budget=15):
    return replay_trainings(Scripted(script), TransferWorld(DATA, 0), budget)


def everybody(length, start=None):
    return Proposal(20, "", length=length, start=start, sources=ALL)


def test_what_is_asked_for_is_rounded_to_a_mark_and_charged_from_where_it_began():
    run = asked(
        everybody(0.3),  # to .5
        everybody(3.0, start=0),  # on to 4
        Proposal(10, "", start=1, length=0.4),  # a copy of the policy of 4 units, for .5
        Proposal(10, "", start=2, length=0.8),  # and on to 1
        Proposal(12, "", start=0, length=0.5),  # no parent is as short
        everybody(8.0, start=1),
        Proposal(12, "", start=4, length=1.0),  # of 8 units: that of 4 answers
        Proposal(11, ""),  # none of the sources
        Proposal(14, ""),
        everybody(15.0, start=4),  # 7 units, and 4 are left
    )
    assert run.trainings == (
        Training(ALL, None, 0.5),
        Training(ALL, 0, 4.0, goes_on=True),
        Training((10,), 1, 0.5),
        Training((10,), 2, 1.0, goes_on=True),
        Training(ALL, 1, 8.0, goes_on=True),
        Training((12,), 4, 1.0),
        Training((14,)),
    )
    assert run.units == pytest.approx([0.5, 4.0, 4.5, 5.0, 9.0, 10.0, 11.0])
    rows = run.history.rows
    assert rows[1] == pytest.approx(DATA.generalists[4.0][0, 0])
    gain = 0.4 * np.maximum(1 - np.abs(X - X[10]) / 0.15, 0.0)
    assert rows[2] - rows[1] == pytest.approx(0.5 * gain)
    assert rows[3] - rows[1] == pytest.approx(gain)
    assert rows[5] - rows[1] == pytest.approx(0.4 * np.maximum(1 - np.abs(X - X[12]) / 0.15, 0.0))
    assert run.value == pytest.approx([rows[: k + 1].max(axis=0).mean() for k in range(len(rows))])
    assert (run.at(0.4), run.at(4.4), run.at(15)) == pytest.approx(
        (np.nan, run.value[1], run.value[-1]), nan_ok=True
    )


def test_what_cannot_be_answered_gave_nothing_and_cost_nothing():
    run = asked(Proposal(8, "", sources=(8, 10)), Proposal(11, ""), Proposal(10, ""))
    assert run.history.given_up == (Training((8, 10)),)
    assert run.history.failed == (11,)
    assert run.refused == (Training((8, 10)), Training((11,)))
    assert run.history.sources == (10,)
    assert run.units == pytest.approx([1.0])
    first = TransferWorld(DATA, 0).history([], list(run.refused), alone=True)
    assert (first.failed, first.given_up) == ((11,), (Training((8, 10)),))
    assert not first.open_mask(41)[11]


@pytest.mark.parametrize(
    ("proposal", "words"),
    [
        (None, "got NoneType None from 'scripted'"),
        (Proposal(-1, ""), "from 0 to 40, .*got -1"),
        (everybody(-1.0), "length >= 0 in units, got -1.0"),
        (everybody(np.nan), "length >= 0 in units, got nan"),
        (everybody(1.0, start=0), "goes on beyond the 1 units that it has, got length=1 "),
        (everybody(2.0, start=-1), "the policy of a row, 0 to 0, got start=-1"),
        (everybody(1.0), "asked for once"),
    ],
)
def test_what_no_study_would_take_is_refused_in_a_replay_too(proposal, words):
    with pytest.raises(InvalidInput, match=words):
        asked(everybody(1.0), proposal)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"seed": 3}, "seed is an index from 0 to 0, got 3"),
        ({"seed": "x"}, "seed must be a whole number"),
        ({"abilities": "length"}, "abilities are some of .*, in a list, got 'length'"),
        ({"chance": 0.5}, "seed must be a whole number, got 0.5"),
        ({"abilities": {"lenght"}}, "abilities are some of .*got .'lenght'"),
        ({"budget": 2.5}, "budget must be a whole number, got 2.5"),
        ({"budget": 0}, "budget must be 1 or more units, got 0"),
        ({"strategy": "aut"}, "Did you mean 'auto'"),
    ],
)
def test_a_replay_that_cannot_be_is_refused(how, words):
    how = {"seed": 0, "abilities": ABILITIES, "budget": 2, "strategy": "auto", **how}

    def replayed():
        world = TransferWorld(DATA, how["seed"], abilities=how["abilities"])
        return replay_trainings(how["strategy"], world, how["budget"], seed=how.get("chance", 0))

    with pytest.raises(MbtlError, match=words):
        replayed()


def test_data_worlds_and_matrices_that_are_mixed_up_are_refused_in_words():
    with pytest.raises(InvalidInput, match=r"load_transfers.id., got 'pendulum-mass'"):
        TransferWorld("pendulum-mass", 0)
    with pytest.raises(InvalidInput, match=r"world is TransferWorld.data, seed., got Transfer"):
        replay_trainings("auto", DATA, 3)
    with pytest.raises(InvalidInput, match="for replay_trainings, got TransferData"):
        mbtl.compare(["random"], [DATA])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"sources": [2, 0]}, r"rising, got array\(\[2, 0\]\)"),
        ({"sources": np.arange(40, 43)}, "indices of contexts from 0 to 40"),
        ({"specialists": DATA.specialists[0]}, r"shape \(1, 2, 21, 41\), got float64 of shape"),
        ({"generalists": {2.0: 0.0, 1.0: 0.0}}, r"rising, got \[2.0, 1.0\]"),
        ({"generalists": {-1.0: 0.0}}, "units of a training must be finite and > 0.*got -1.0"),
        (
            {"tuned": {(1.0, 0.5): np.full_like(DATA.specialists, np.inf)}},
            r"tuned\[1, 0.5\] must be finite",
        ),
        ({"std": {}}, "std of specialists must be finite numbers"),
    ],
)
def test_transfer_data_that_cannot_be_are_refused(wrong, words):
    with pytest.raises(InvalidInput, match=words):
        replace(DATA, **wrong)


def test_data_may_lack_policies_for_all_and_copies():
    alone = {"specialists": DATA.std["specialists"]}
    data = replace(DATA, generalists={}, tuned={}, std=alone, specialists=DATA.specialists.tolist())
    run = replay_trainings("auto", TransferWorld(data, 0), 3)
    assert (len(run.trainings), len(run.refused[0].contexts)) == (3, data.sources.size)


@pytest.mark.parametrize("name", ["mbtl", "m-mbtl", "specialists"])
def test_a_selector_is_replayed_as_on_the_matrix_of_specialists(name):
    data = transfer_worlds.one_for_all_fails(noise=0.05, seeds=(0, 1))
    matrix, selector = specialists_of(data), get_selector(name)
    run = replay_trainings(selector, TransferWorld(data, 1), 5)
    assert run.value == pytest.approx(
        [float(v) for v in measured_curve(matrix, 1, [one.contexts[0] for one in run.trainings])]
    )
    if name != "specialists":  # that one heeds the noise, which the other replay does not tell
        plain = replay(selector, matrix.problem(5), lambda x: matrix.rows(1, [x])[0])
        assert [one.contexts[0] for one in run.trainings] == list(plain.history.sources)


def test_noise_is_told_as_standard_errors_and_v_is_of_the_other_episodes():
    data = transfer_worlds.one_policy_suffices(noise=0.2)
    run = replay_trainings(Scripted((everybody(1.0),)), TransferWorld(data, 0), 1)
    assert run.history.errors[0] == pytest.approx(0.2 / np.sqrt(10))
    assert run.history.rows[0] == pytest.approx(data.generalists[1.0][0, 0])
    assert run.value == pytest.approx([data.generalists[1.0][0, 1].mean()])


def test_a_run_ends_where_a_whole_training_is_asked_for_and_half_a_unit_is_left():
    run = asked(everybody(0.5), Proposal(4, ""), Proposal(6, ""), Proposal(8, ""), budget=2)
    assert run.units == pytest.approx([0.5, 1.5])
    assert run.refused == ()


def test_a_policy_for_all_closes_no_context_for_specialists():
    history = asked(everybody(0.5), Proposal(4, ""), budget=2).history
    assert history.tried == (4,)
    assert np.flatnonzero(~history.open_mask(history.n_targets)).tolist() == [4]


def test_a_strategy_is_replayed_as_if_it_had_never_seen_the_family():
    data = mbtl.load_transfers("pendulum-length")
    world, own = TransferWorld(data, 0), get_selector("specialists")
    fair, seen = own.without("pendulum"), replace(own, prior=PRIORS["all"])
    runs = [replay_trainings(one, world, 6).trainings for one in (own, fair, seen)]
    assert runs[0] == runs[1] != runs[2]
    assert AllFirst(own).without("pendulum") == AllFirst(fair)
