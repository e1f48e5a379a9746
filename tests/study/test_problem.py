"""A study knows its problem: what belongs to a CMDP comes from it and is checked against it."""

import io
import sys

import numpy as np
import pytest

import mbtl
from flat import created
from mbtl.errors import InvalidInput, StudyError, StudyMismatch, UnknownName
from mbtl.problems import CMDP, Preset
from mbtl.study import Callback
from mbtl.study.callbacks import PrintProgress
from mbtl.trainers import FunctionTrainer

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("gravity", 1.0, 9.0, unit="m/s2"): 9})


class Toy(FunctionTrainer):
    """Costs |x - x'|, with a recipe that presets may change."""

    def __init__(self, steps=10):
        super().__init__(
            lambda context, seed: context["gravity"],
            lambda policy, contexts, seeds: [abs(policy - c["gravity"]) for c in contexts],
            lambda policy, folder: (folder / "p").write_text(str(policy)),
            lambda folder: float((folder / "p").read_text()),
        )
        object.__setattr__(self, "recipe", {"steps": steps})


def problem(**record):
    record = {"bounds": (0.0, 4.0), "direction": "minimize", "theta": 0.1, "version": 3, **record}
    presets = {"quick": Preset(3), "long": Preset(5)}
    return CMDP("toy", SPACE, Toy(), presets=presets, best_return=0.0, **record)


@pytest.mark.parametrize("make", [lambda p, **s: p.study(**s), mbtl.create_study])
def test_a_study_of_a_problem_needs_nothing_said_twice(tmp_path, make):
    cmdp = problem()
    study = make(cmdp, strategy="random", storage=tmp_path / "s.db").run(report=False).study
    assert study.space == SPACE
    spec = study.spec
    assert (spec.budget, spec.bounds, spec.direction) == (3, (0.0, 4.0), "minimize")
    assert (spec.theta, spec.best_return, spec.problem) == (0.1, 0.0, "toy")
    assert spec.settings["preset"] == "quick"
    assert study.state.equipment["recipe"] == {"steps": 10}
    assert study.portfolio().policy(0) == SPACE.context(study.history.sources[0])["gravity"]
    again = mbtl.load_study(tmp_path / "s.db", problem=cmdp)
    assert again.portfolio().policy_for({"gravity": 9.0}) in SPACE.values("gravity")
    assert make(cmdp, strategy="random", storage=tmp_path / "s.db", load_if_exists=True).is_finished


def test_what_is_given_counts_more_than_the_problem():
    trainer = Toy(steps=20)
    given = problem(settings={"note": 1})
    study = created(given, preset="long", budget=2, bounds=(0.0, 8.0), trainer=trainer)
    assert (study.spec.budget, study.spec.bounds, study.trainer) == (2, (0.0, 8.0), trainer)
    assert study.spec.settings["recipe"] == {"steps": 20}
    assert (study.spec.settings["preset"], study.spec.settings["switches"]) == ("long", {"note": 1})
    with pytest.raises(UnknownName, match="preset"):
        created(problem(), preset="lon")
    with pytest.raises(InvalidInput, match="ContextSpace or a CMDP, got dict"):
        mbtl.create_study({"gravity": 1.0}, budget=3)
    with pytest.raises(InvalidInput, match="needs budget="):
        mbtl.create_study(SPACE)
    with pytest.raises(InvalidInput, match="or a trainer"):
        mbtl.create_study(SPACE, budget=3).run()


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (problem(version=4), "version was 3, got 4"),
        (problem(settings={"visibility": "raw"}), "switches"),
        (CMDP("else", SPACE, Toy(), version=3), "problem was 'toy', got 'else'"),
        (CMDP("toy", SPACE.every(2), Toy(), version=3), "the number of contexts was"),
    ],
)
def test_another_problem_is_refused(tmp_path, other, words):
    problem().study(storage=tmp_path / "s.db")
    with pytest.raises(StudyMismatch, match=words):
        mbtl.load_study(tmp_path / "s.db", problem=other)


def test_a_preset_that_is_gone_still_loads_and_another_recipe_does_not_train(tmp_path):
    created(problem(), preset="long", strategy="random", storage=tmp_path / "s.db").run(
        report=False
    )
    later = CMDP("toy", SPACE, Toy(steps=99), version=3)
    study = mbtl.load_study(tmp_path / "s.db", problem=later)
    assert isinstance(study.portfolio().policy(0), float)
    study.extend(6)
    with pytest.raises(StudyMismatch, match=r"recipe\.steps was 10, got 99"):
        study.run()


OWN = """
from dataclasses import dataclass
from mbtl.selectors import Proposal
@dataclass(frozen=True)
class Last:
    back: int = 1
    name: str = "last"
    def propose(self, problem, history, rng):
        return Proposal(problem.n - len(history) - self.back, "from the end")
"""


def test_a_selector_in_a_file_is_named_in_the_log_and_never_run_from_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "own_selector.py").write_text(OWN)
    reference = "own_selector.py:Last"
    study = problem().study(strategy=reference, storage="s.db").run(report=False).study
    assert study.history.sources == (8, 7, 6)
    with pytest.raises(StudyError, match=r"'last'; give it as strategy='own_selector\.py:Last'"):
        mbtl.load_study("s.db")
    assert mbtl.load_study("s.db", strategy=reference).is_finished
    elsewhere = f"{tmp_path}/own_selector.py:Last"  # the same, by another path
    assert problem().study(strategy=elsewhere, storage="s.db", load_if_exists=True).is_finished
    changed = study.selector.__class__(back=2)
    with pytest.raises(StudyMismatch, match="back"):
        problem().study(strategy=changed, storage="s.db", load_if_exists=True)
    with pytest.raises(StudyMismatch, match="give the same one"):
        mbtl.load_study("s.db", strategy="random")


def test_a_line_per_pick_is_for_people_who_count_from_1(capsys):
    study = problem().study(strategy="equidistant").run(report=False).study
    first, note, second, _ = capsys.readouterr().err.splitlines()
    assert first.startswith("pick 1 of 3: gravity = 8 m/s2, V = ")
    assert note.startswith("one episode per context says nothing of chance: play 2 or more")
    assert second.startswith("pick 2 of 3: gravity = 5 m/s2, V = ")
    assert second.endswith(f"(gain {study.curve[1] - study.curve[0]:.4f})")
    problem().study(strategy="equidistant").run(report=False, progress=False)
    assert capsys.readouterr() == ("", "")
    study = problem().study(strategy="specialists")
    pick = study.ask()
    assert str(pick) == "pick 1: gravity = 5.0 (middle of the range)"
    PrintProgress(said := io.StringIO()).on_failed(study, pick, "licence expired")
    assert said.getvalue() == "pick 1 of 3: gravity = 5 m/s2 failed: licence expired\n"


def test_a_run_that_joins_is_told_so(tmp_path, capsys):
    first = problem().study(strategy="random", storage=tmp_path / "s.db")
    first.ask()
    heard = []

    class Ear(Callback):
        def on_shared(self, study, others):
            heard.extend(others)

    study = mbtl.load_study(tmp_path / "s.db", problem=problem())
    study.run(callbacks=[Ear()], report=False)
    assert heard == [first.worker]
    assert f"{first.worker} works on this study, too" in capsys.readouterr().err
    assert len(study.state.rows) == 2  # the third is theirs
    assert np.isfinite(study.value)
