"""A log that is damaged, or of a stranger: refused in one sentence, and nothing of it is done."""

import copy
import dataclasses
import io
import json
import random
import re
import sqlite3
from decimal import Decimal

import numpy as np
import pytest
import quick_problem

import mbtl
from damage import damaged, damaged_bytes, refusals
from flat import created
from mbtl.errors import InvalidInput, StorageError, StudyError
from mbtl.report import summarise_study
from mbtl.seeds import training_seed
from mbtl.selectors import Proposal, Traits
from mbtl.strategies import get_strategy
from mbtl.study import MemoryLog, Study
from mbtl.study.artifacts import Artifact
from mbtl.study.events import Event
from mbtl.study.storage import checksum_of

SPACE = mbtl.ContextSpace.grid(
    {mbtl.Linear("mass", 1.0, 3.0, unit="kg"): 3, mbtl.Integer("n", 1, 2): 2}
)


@pytest.fixture
def study(tmp_path):
    """A study in a file with events of every kind but one."""
    made = created(
        SPACE, budget=3, bounds=(0.0, 9.0), costs=np.arange(1, 7), cost_budget=50,
        eval_targets=4, settings={"recipe": {"steps": 3}}, storage=tmp_path / "study.db",
    )  # fmt: skip
    (tmp_path / "policies" / "a").mkdir(parents=True)
    (tmp_path / "policies" / "a" / "theta.txt").write_text("7")
    made.tell(made.ask(), np.arange(8.0).reshape(4, 2), policy="policies/a", seconds=1.5)
    made.release(made.ask())
    made.fail(made.ask(), "diverged")
    made.tell(5, np.full(6, 3.0))
    made.record_fresh_returns(np.full((6, 2), 2.0), np.ones((6, 2)), best_single=1)
    made.extend(4)
    made.tell(4, np.zeros(6))
    made.void(2, "told by mistake")
    return made


class InTurn:
    """All contexts, longer, a copy tuned from that, the second one evaluated further."""

    name, traits = "in-turn", Traits(any_training=True)
    script = (
        Proposal(2, "all", length=1.0, sources=tuple(range(6)), targets=(0, 3)),
        Proposal(2, "longer", start=0, length=2.5, sources=tuple(range(6))),
        Proposal(4, "tuned", start=1, length=0.5, targets=(1, 4)),
        Proposal(2, "further", start=0, length=0.0, sources=tuple(range(6)), targets=(1, 2)),
        Proposal(1, "alone"),
    )

    def propose(self, problem, history, rng):
        under_way = len(history.under_way) + len(history.pending) + len(history.failed)
        further = len(history) == 3 and np.isfinite(history.rows[0]).sum() > 2
        return self.script[len(history) + under_way + further]


@pytest.fixture
def any_training(tmp_path):
    """One that counts steps, with all kinds of picks."""
    made = created(
        SPACE, budget=mbtl.Steps(60_000, unit=1_000, horizon=100), bounds=(0.0, 9.0),
        strategy=InTurn(), storage=tmp_path / "any.db",
    )  # fmt: skip
    state = Artifact("policies/all.state", "0" * 64)
    made.tell(made.ask(), np.ones((2, 3)), policy="policies/all", steps=1_000,
              training_state=state, evaluation_steps=300)  # fmt: skip
    made.fail(made.ask(), "diverged", steps=1_200, again=True)
    longer = made.ask()
    made.defer(longer, "no display")
    made.tell(longer, np.full((6, 3), 2.0), steps=2_500)
    made.tell(made.ask(), np.full((2, 3), 3.0))
    made.tell(made.ask(), np.full((2, 3), 4.0), evaluation_steps=250)
    alone = made.ask()
    made.release(alone)
    mine = made.ask()
    made.tell(alone, np.zeros(6))  # late
    made.fail(mine, "diverged", steps=400)
    return made


def events(study):
    """The log as lists and records."""
    return [
        {"kind": e.kind, "data": copy.deepcopy(dict(e.data)), "arrays": dict(e.arrays)}
        for e in study.log.read()
    ]


def read(log, folder=None):
    """A study of such a log, in memory."""
    memory = MemoryLog()
    for i, e in enumerate(log):
        memory.append(Event(e["kind"], e["data"], e["arrays"]), after=i)
    return Study(memory, get_strategy("all-first"), folder=folder)


def told(log):
    """The first row of a log."""
    return next(entry for entry in log if entry["kind"] == "told")


def written(place, log):
    """Put a log in the place of the one in a database, as its rows."""
    rows = []
    for i, e in enumerate(log):
        packed = io.BytesIO()
        np.savez(packed, **e["arrays"])
        arrays = e.get("packed", packed.getvalue() if e["arrays"] else b"")
        text = e.get("text", json.dumps(e["data"]))
        try:
            checksum = checksum_of(i + 1, e["kind"], text, arrays)
        except TypeError:  # no text, or no bytes
            checksum = ""
        rows.append(("study", i + 1, e.get("time", 1.0), e["kind"], text, arrays, checksum))
    with sqlite3.connect(place / "study.db") as connection:
        connection.execute("DELETE FROM mbtl_events")
        connection.executemany("INSERT INTO mbtl_events VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
    connection.close()
    return place


def used(study):
    """Everything that is done with a study of a stranger's."""
    study.value, study.curve, study.is_finished, study.orphans, repr(study)
    summarise_study(study).to_json()
    study.portfolio().explain({"mass": 1.5, "n": 1})
    study.state.bill()
    study.extend(5 if study.spec.steps is None else mbtl.Steps(10**6))
    study.open_picks()
    study.ask()


# ---- strangers --------------------------------------------------------------------------------


def test_a_name_that_leads_out_of_the_study_is_refused_with_its_event(study, tmp_path):
    policies = ["/etc", "../secret", "policies/../../secret", "C:\\x", ".ssh", "a/.ssh", "", 3]
    for place, name, wrong, words in (
        (3, "policy", policies, r"event 4 \(told\) .*`policy` cannot be"),
        (0, "uid", ("../..", "a/b", "", "x" * 65, None), r"event 1 \(created\) .*`uid` cannot be"),
    ):
        for value in wrong:
            log = events(study)
            log[place]["data"][name] = value
            with pytest.raises(StorageError, match=words):
                mbtl.load_study(written(tmp_path, log))
    written(tmp_path, events(study))
    with pytest.raises(InvalidInput, match="`policy` must be a folder inside the study's own"):
        study.tell(3, np.zeros(6), policy="/etc")
    assert len(study.refresh().rows) == 2


def test_a_key_behind_a_link_is_not_copied(study, tmp_path):
    outside = tmp_path.parent / f"{tmp_path.name}-home"
    outside.mkdir()
    (outside / "id_rsa").write_text("secret")
    place = tmp_path / "policies" / "a"
    (place / "key").symlink_to(outside / "id_rsa")
    portfolio = study.portfolio()
    with pytest.raises(StorageError, match="got the link"):
        portfolio.save(tmp_path / "p", allow_missing=True)
    (place / "key").unlink()
    portfolio.save(tmp_path / "p", allow_missing=True)
    place.rename(tmp_path / "moved")
    place.symlink_to(outside)
    with pytest.raises(StorageError, match=r"got the link .*policies/a"):
        study.portfolio()


def test_a_run_writes_no_policies_through_a_link(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "policies").symlink_to(tmp_path / "elsewhere")
    study = mbtl.create_study(SPACE, budget=2, storage=tmp_path / "s" / "study.db")
    with pytest.raises(StorageError, match=r"got the link .*policies"):
        study.run(trainer=quick_problem.TRAINER)
    assert not list((tmp_path / "elsewhere").iterdir())
    assert not study.refresh().failures


# ---- damage -----------------------------------------------------------------------------------


@pytest.mark.parametrize("which", ["study", "any_training"])
def test_any_damage_to_the_facts_gets_a_sentence(which, request):
    study = request.getfixturevalue(which)
    whole, refused = events(study), {}

    def attempt(seed):
        log = copy.deepcopy(whole)
        entry = log[seed % len(log)]
        entry["data"] = json.loads(json.dumps(damaged(entry["data"], seed)))
        try:
            opened = read(log, folder=study.folder)
        except StorageError as error:
            refused[entry["kind"]] = str(error)
            raise
        used(opened)

    assert refusals(attempt, 80) > 24
    assert set(refused) == {e["kind"] for e in whole}
    assert all(re.search(r"event \d+ |newer mbtl", said) for said in refused.values())


def test_no_flipped_bit_loads(study, tmp_path):
    rng, place = random.Random(0), written(tmp_path, events(study))
    with sqlite3.connect(place / "study.db") as base:
        whole = base.execute("SELECT seq, kind, data, arrays FROM mbtl_events").fetchall()
        for _ in range(20):
            seq, *entry = rng.choice(whole)
            column = rng.choice([i for i, value in enumerate(entry) if value])
            value = entry[column]
            changed = bytearray(value.encode() if isinstance(value, str) else value)
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(7)
            entry[column] = changed.decode() if isinstance(value, str) else bytes(changed)
            change = "UPDATE mbtl_events SET kind = ?, data = ?, arrays = ? WHERE seq = ?"
            base.execute(change, (*entry, seq))
            base.commit()
            with pytest.raises(StorageError, match=f"event {seq} .* does not fit its checksum"):
                mbtl.load_study(place)
            base.executemany(change, [(*was, seq) for seq, *was in whole])
        for here, there in ((5, 99), (6, 5), (99, 6)):
            base.execute("UPDATE mbtl_events SET seq = ? WHERE seq = ?", (there, here))
        base.commit()
    with pytest.raises(StorageError, match=r"event 5 .* does not fit its checksum"):
        mbtl.load_study(place)


def test_any_damage_to_the_database_gets_a_sentence(study, tmp_path):
    whole = events(study)
    odd = [
        *(None, "text", b"bytes", 3, 10**12, -1.0),
        *("", "{}", "[]", '{"a": NaN}', "[" * 9999, b"\xff"),
    ]

    def attempt(seed):
        rng, log = random.Random(seed), copy.deepcopy(whole)
        entry = rng.choice([told(log), *log])
        changes = ["text", "time", "kind", "packed", "arrays", "arrays", "bytes", "event"]
        change = rng.choice(changes)
        if change == "event":
            log.remove(entry)
        elif change == "bytes":
            packed = io.BytesIO()
            np.savez(packed, **entry["arrays"])
            entry["packed"] = damaged_bytes(packed.getvalue(), seed)
        elif change == "arrays":
            name = rng.choice([*entry["arrays"], "other"])
            shape = rng.choice([(6,), (2, 6), (0,), (), (7,)])
            filled = rng.choice([1.0, np.nan, np.inf, 1e308, "a", 1j])
            entry["arrays"][name] = np.full(shape, filled)
        else:
            entry[change] = rng.choice(odd)
        try:
            written(tmp_path, log)
        except sqlite3.IntegrityError:  # NULL
            return
        used(mbtl.load_study(tmp_path))

    assert refusals(attempt, 24) > 12


def test_a_training_that_cannot_be_is_refused(any_training):
    whole = events(any_training)
    for kind, which, change, words in (
        ("asked", 0, {"sources": []}, "`sources` cannot be"),
        ("asked", 0, {"sources": [2, 2]}, "`sources` cannot be"),
        ("asked", 0, {"start": 1}, "`start` cannot be"),
        ("asked", 0, {"length": -1.0}, "`length` cannot be"),
        ("asked", 0, {"length": 1e300}, "`length` cannot be"),
        ("asked", 0, {"length": 0.0}, "only evaluates a policy .* has a start= and targets="),
        ("asked", 0, {"targets": [1, 1]}, "`targets` cannot be"),
        ("asked", 1, {"length": 1.0}, "goes on beyond the"),
        ("asked", 3, {"targets": None}, "only evaluates a policy .* has a start= and targets="),
        ("told", 0, {"sources": [1]}, "the contexts of its pick"),
        ("told", 0, {"targets": [3, 0]}, "`targets` cannot be"),
        ("told", 0, {"state": "../.ssh"}, "`state` cannot be"),
        ("told", 0, {"steps": -1.0}, "`steps` cannot be"),
        ("told", 3, {"evaluation_steps": "few"}, "`evaluation_steps` cannot be"),
        ("late", 0, {"episodes": None}, "`episodes` cannot be"),
        ("late", 0, {"targets": 3}, "`targets` cannot be"),
        ("failed", 0, {"steps": True}, "`steps` cannot be"),
        ("failed", 0, {"again": 1}, "`again` cannot be"),
        ("failed", 1, {"pick": 0}, "`pick` cannot be"),
    ):
        log = copy.deepcopy(whole)
        [entry for entry in log if entry["kind"] == kind][which]["data"].update(change)
        with pytest.raises(StorageError, match=words):
            read(log)
    for facts in (
        {"budget": 1, "steps": 10},
        {"budget": 10**6, "steps": None},
        {"budget": 10**6, "to_the_end": True},
        {"budget": 60, "to_the_end": True, "steps": None},
    ):
        with pytest.raises(StorageError, match="cannot be"):
            read([*whole, {"kind": "extended", "data": facts, "arrays": {}}])


def test_a_long_chain_of_trainings_is_read(any_training):
    """Of each that goes on it is known what it began with; Python's stack is 1,000 deep."""
    begun, asked, answer = (
        next(e for e in events(any_training) if e["kind"] == kind)
        for kind in ("created", "asked", "told")
    )
    log = [begun]
    for i in range(1_001):
        start = len(log) if i else None
        facts = {"pick": i, "start": start, "length": 1.0 + i, "token": f"t{i}"}
        log.append({**asked, "data": {**asked["data"], **facts}})
        log.append({**answer, "data": {**answer["data"], "pick": i, "token": f"t{i}"}})
    study = read(log)
    assert study.pick(1_000).seed == study.pick(0).seed
    assert study.pick(1_000).done == 1_000.0
    seeds = [training_seed(0, 0, range(6), lineage=lineage) for lineage in ((), (1, 2, 3))]
    assert study.pick(0).seed == seeds[0] != seeds[1]


# ---- picks and numbers ------------------------------------------------------------------------


def test_a_pick_of_another_study_answers_nothing():
    studies = [
        mbtl.create_study(SPACE, budget=3, strategy=name) for name in ("mbtl", "worst-first")
    ]
    ours, theirs = (study.ask() for study in studies)
    other = dataclasses.replace(theirs, sources=((ours.source + 1) % 6,))
    for answer in (lambda p: studies[0].tell(p, np.zeros(6)), lambda p: studies[0].fail(p, "no"),
                   lambda p: studies[0].release(p)):  # fmt: skip
        with pytest.raises(StudyError, match="tell the study that gave it"):
            answer(other)
    studies[0].tell(ours, np.zeros(6))
    assert studies[0].state.rows[0].source == ours.source


def test_numbers_of_numpy_are_recorded_and_no_numbers_are_not(tmp_path):
    number, three = np.float32(0.5), np.int64(3)
    assert mbtl.ContextSpace.grid({mbtl.Integer("n", three, 2 * three): three}).n == 3
    study = created(
        SPACE, budget=three, theta=number, stop_value=number, bounds=(number, three),
        direction="max", seed=three, storage=tmp_path / "a.db",
    )  # fmt: skip
    study.tell(study.ask(), np.zeros(6), seconds=number, cost=number)
    assert mbtl.load_study(tmp_path / "a.db").spec.theta == 0.5
    assert study.spec.direction == "maximize"
    for fact, wrong in (("seconds", np.nan), ("steps", -5), ("cost", -5)):
        with pytest.raises(InvalidInput, match=rf"{fact} must be finite, from 0 to 1e\+30, got"):
            study.tell(study.ask(), np.zeros(6), **{fact: wrong})
        study.release(len(study.state.picks) - 1)
    with pytest.raises(InvalidInput, match="distinct context indices"):
        study.tell(2, np.zeros(1), targets=[0.9])


@pytest.mark.parametrize("odd", [np.True_, Decimal(1), 1e300])
def test_what_no_log_can_hold_is_refused_before_it_is_written(odd, tmp_path):
    class Odd:
        name = "odd"

        def propose(self, problem, history, rng):
            return Proposal(0, "why not", acquisition=odd)

    study = mbtl.create_study(SPACE, budget=2, strategy=Odd(), storage=tmp_path / "study.db")
    with pytest.raises(InvalidInput, match="acquisition"):
        study.ask()
    (entry,) = mbtl.study.list_studies(tmp_path)  # which reads all of it
    assert entry.told == 0
