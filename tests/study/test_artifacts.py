"""Policies are the study's and never lost: kept in a folder or a store, published by their row."""

import os
import pickle
import shutil
import uuid
from dataclasses import replace
from pathlib import Path

import pytest
from line_problem import SPACE, TRAINER, evaluate, load, save, train

import mbtl
from flat import created, ran
from mbtl.errors import InvalidInput, StorageError, StudyMismatch, UnsavedPolicies
from mbtl.study import artifacts, database
from mbtl.study.artifacts import Artifact, FolderStore, RemoteStore, policy_store
from mbtl.study.job import Job, perform_elsewhere
from mbtl.study.study import Callback
from mbtl.trainers.contract import FunctionTrainer, Trained, recipe_digest

PLACE = "policies/uid/source-0001-token"


def fill(folder):
    """A policy of two files, one of them in a folder."""
    (folder / "weights").mkdir()
    (folder / "weights" / "a.bin").write_bytes(b"\x00\x01")
    (folder / "about.txt").write_text("1.5")
    return True


@pytest.fixture(params=["folder", "memory"])
def store(request, tmp_path):
    """Empty and new."""
    if request.param == "folder":
        return FolderStore(tmp_path)
    pytest.importorskip("fsspec")
    return RemoteStore(f"memory://{uuid.uuid4().hex}")


def test_what_is_read_is_what_was_written(store):
    """With its receipt, and also by another process."""
    made = store.write(PLACE, fill, {"seed": 3})
    assert made is not None
    other = pickle.loads(pickle.dumps(store))
    receipt = other.receipt(PLACE)
    assert (receipt["seed"], receipt["sha256"]) == (3, made.sha256)
    folder = other.read(PLACE, made.sha256)
    assert (folder / "weights" / "a.bin").read_bytes() == b"\x00\x01"
    assert (folder / "about.txt").read_text() == "1.5"


def test_a_place_that_can_be_written_says_so_and_stays_usable(store):
    """It is asked before every run."""
    store.check()
    store.check()
    assert store.write(PLACE, fill, {}) is not None


def test_what_is_not_there_is_not_there(store):
    """No error: a row may have no policy."""
    assert store.receipt(PLACE) is None
    assert not store.read(PLACE).exists()


def test_what_cannot_be_saved_leaves_nothing(store):
    """Neither where it says so, nor where it breaks."""

    def broken(folder):
        fill(folder)
        raise RuntimeError("half way")

    assert store.write(PLACE, lambda folder: False, {}) is None
    with pytest.raises(RuntimeError, match="half way"):
        store.write(PLACE, broken, {})
    assert store.receipt(PLACE) is None


def test_another_hash_is_refused(store):
    """The row that was told means the files that were there then."""
    assert isinstance(store.write(PLACE, fill, {}), Artifact)
    with pytest.raises(StorageError, match="not the one that was told"):
        store.read(PLACE, "0" * 64)


def study_at(place, artifacts=None, **settings):
    """In memory, in a folder, or in a file or database."""
    if isinstance(place, Path) and place.is_dir():
        place = place / "study.db"
    settings = {"budget": 2, "bounds": (0.0, 1.0), "strategy": "random", **settings}
    return created(SPACE, storage=place, artifacts=artifacts, load_if_exists=True, **settings)


@pytest.mark.parametrize("kind", ["folder", "memory"])
def test_a_study_keeps_its_policies_where_it_is_told(tmp_path, kind):
    kept = tmp_path / "kept"
    address = kept.as_uri() if kind == "folder" else f"memory://{uuid.uuid4().hex}"
    study = study_at(tmp_path, address).run(trainer=TRAINER).study
    assert not (tmp_path / "policies").exists()
    later = mbtl.load_study(tmp_path, artifacts=address)
    for i, row in enumerate(later.state.rows):
        assert row.policy.endswith(later.state.picks[row.pick].answered_by)
        assert len(row.sha256) == 64
        assert row.recipe == recipe_digest(later.state.equipment)
        assert later.portfolio(TRAINER).policy(i) == pytest.approx(SPACE.unit[row.source])
    study.portfolio(TRAINER).save(tmp_path / "portfolio")
    assert mbtl.load_portfolio(tmp_path / "portfolio", load=TRAINER.load).policy(0) is not None
    if kind == "folder":
        kept.rename(tmp_path / "moved")
        moved = mbtl.load_study(tmp_path, artifacts=tmp_path / "moved")
        assert moved.portfolio(TRAINER).policy(0) == SPACE.unit[moved.history.sources[0], 0]


def test_another_place_for_policies_is_noticed_at_once(tmp_path):
    address = f"memory://{uuid.uuid4().hex}"
    study_at(tmp_path, address, budget=1).run(trainer=TRAINER, report=False)
    for there in address, f"{address}-mistyped", tmp_path / "mistyped":
        study, heard, ear = mbtl.load_study(tmp_path, artifacts=there), [], Callback()
        ear.on_note = lambda study, words, heard=heard: heard.append(words)
        study.run(trainer=TRAINER, report=False, callbacks=[ear])
        assert heard == [] if there == address else f"training 1 is not in {there}:" in heard[0]
    told = study_at(tmp_path / "other.db", budget=2)
    told.tell(0, evaluate(0.0, SPACE.contexts, []), policy="my/own")  # no run has written it
    heard.clear()
    told.run(trainer=TRAINER, report=False, callbacks=[ear])
    assert not heard


def test_a_policy_whose_files_have_changed_is_not_read(tmp_path):
    study = study_at(tmp_path, budget=3).run(trainer=TRAINER).study
    place = tmp_path / study.state.rows[1].policy
    (place / "x.txt").write_text("9.0")
    with pytest.raises(StorageError, match="is not the one that was told"):
        study.portfolio(TRAINER)
    study.void(1, "a changed file")
    assert study.portfolio(TRAINER).policy(1) is not None


def test_a_study_whose_policies_are_gone_goes_on_and_says_what_it_cannot_do(tmp_path):
    study = study_at(tmp_path, budget=1).run(trainer=TRAINER).study
    shutil.rmtree(tmp_path / "policies")
    study.extend(2)
    heard, ear = [], Callback()
    ear.on_note = lambda study, words: heard.append(words)
    result = study.run(trainer=TRAINER, callbacks=[ear])
    assert "training 1 is not in" in heard[0]
    assert "could not be measured: the policies of trainings [1]" in heard[-1]
    assert (len(study.state.rows), result.fresh) == (2, None)


def test_a_run_that_could_not_be_closed_pays_for_nothing(tmp_path):
    study = study_at(tmp_path, budget=2).run(trainer=TRAINER).study
    (tmp_path / study.state.rows[0].policy / "x.txt").write_text("9.0")
    study.extend(3)
    with pytest.raises(StorageError, match="is not the one that was told"):
        study.run(trainer=TRAINER)
    assert len(study.refresh().picks) == 2


def test_a_saved_policy_of_a_dead_worker_is_evaluated_and_not_trained_again(tmp_path):
    """Also where its folder is an object store: the receipt is looked for under earlier tokens."""

    def interrupted(policy, contexts, seed):
        raise KeyboardInterrupt

    address, trained = f"memory://{uuid.uuid4().hex}", []
    stopped = replace(TRAINER, evaluate_fn=interrupted)
    with pytest.raises(KeyboardInterrupt):
        study_at(tmp_path, address, budget=1).run(trainer=stopped)
    again = replace(TRAINER, train_fn=lambda c, s: trained.append(s) or train(c, s))
    study = study_at(tmp_path, address, budget=1).run(trainer=again).study
    assert (len(study.state.rows), trained) == (1, [])
    first, second = study.state.picks[0].tokens
    assert study.state.rows[0].policy.endswith(first)
    assert study.state.picks[0].answered_by == second


class Resuming(FunctionTrainer):
    """Counts to ten, and notes in `state` how far it is."""

    takes = frozenset({"resume"})

    def __init__(self, stop_at=None, **recipe):
        super().__init__(train, evaluate, TRAINER.save_fn, TRAINER.load_fn)
        object.__setattr__(self, "stop_at", stop_at)
        object.__setattr__(self, "recipe", recipe)
        object.__setattr__(self, "began_at", [])

    def train(self, contexts, seed, *, state=None, **asked):
        begin = int(state.read_text()) if state.is_file() else 0
        self.began_at.append(begin)
        for step in range(begin, 10):
            state.write_text(str(step))
            if step == self.stop_at:
                raise KeyboardInterrupt
        return Trained(train(contexts[0], seed))


@pytest.mark.parametrize(("rate", "began_at"), [(1, 7), (2, 0)])
def test_a_training_goes_on_from_the_checkpoint_of_a_dead_worker_of_its_recipe(
    tmp_path, rate, began_at
):
    with pytest.raises(KeyboardInterrupt):
        study_at(tmp_path, budget=1).run(trainer=Resuming(stop_at=7, rate=1))
    later = Resuming(rate=rate)
    study_at(tmp_path, budget=1).run(trainer=later)
    assert later.began_at == [began_at]
    assert bool(list(tmp_path.rglob("*.partial"))) == (rate == 2)


@pytest.mark.parametrize(
    ("given", "address", "expected"),
    [
        (None, None, None),
        (None, "postgresql://host/studies", None),
        (None, "sqlite:////data/s.db", FolderStore(Path("/data"))),
        ("/kept", "sqlite:////data/s.db", FolderStore(Path("/kept"))),
        ("file:///a%20b", None, FolderStore(Path("/a b"))),
        ("s3://bucket/studies/", None, RemoteStore("s3://bucket/studies")),
    ],
)
def test_where_a_store_is(given, address, expected):
    assert policy_store(address, given) == expected


def test_a_store_that_cannot_be_reached_is_named_and_spends_nothing(tmp_path):
    with pytest.raises(InvalidInput, match="got an empty text"):
        study_at(tmp_path, "")
    study = study_at(tmp_path, "no-such-protocol://bucket")
    with pytest.raises(StorageError, match="no-such-protocol://bucket could not be"):
        study.run(trainer=TRAINER)
    assert not study.state.failures


# ---- a place that cannot be written ------------------------------------------------------------

TRAINED = []


def counted(context, seed):
    TRAINED.append(context["x"])
    return context["x"]


COUNTING = replace(TRAINER, train_fn=counted)


def test_a_place_that_cannot_be_written_is_found_before_the_first_training(tmp_path):
    TRAINED.clear()
    (tmp_path / "file").write_text("no folder")
    study, trainer = study_at(tmp_path, tmp_path / "file" / "kept"), COUNTING
    with pytest.raises(StorageError, match=r"nothing can be written there.*nothing is trained"):
        study.run(trainer=trainer, progress=False)
    assert TRAINED == []
    (tmp_path / "file").unlink()
    study.run(trainer=trainer, progress=False)
    assert len(TRAINED) > 0


class Full(FolderStore):
    """A disk that is full when the policy is there."""

    def write(self, place, fill, receipt):
        raise OSError(28, "No space left on device")


@pytest.mark.parametrize("beside", [True, False])
def test_a_policy_that_cannot_be_saved_waits_for_the_next_run(tmp_path, monkeypatch, beside):
    TRAINED.clear()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    if not beside:
        (tmp_path / "waiting").write_text("no room beside the database")
    study, trainer = study_at(tmp_path, tmp_path / "kept", budget=1), COUNTING
    study.artifacts = Full(tmp_path / "kept")
    place = tmp_path / "waiting" if beside else tmp_path / "cache" / "mbtl" / "waiting"
    with pytest.raises(StorageError, match=rf"waits in {place}.*not trained again"):
        study.run(trainer=trainer, progress=False)
    assert len(list(place.rglob("x.txt"))) == 1

    again = mbtl.load_study(tmp_path, artifacts=tmp_path / "kept")
    again.artifacts = Full(tmp_path / "kept")
    with pytest.raises(StorageError, match="not trained again"):
        again.run(trainer=trainer, progress=False)
    again = mbtl.load_study(tmp_path, artifacts=tmp_path / "kept")
    again.run(trainer=trainer, progress=False)
    assert len(TRAINED) == len(again.state.rows) == 1
    assert again.portfolio(trainer).policy(0) == TRAINED[0]
    assert list(place.rglob("x.txt")) == []


def test_where_no_disk_has_room_the_policy_is_said_to_be_in_memory_alone(tmp_path, monkeypatch):
    TRAINED.clear()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    room = []

    def full(policy, folder):
        if not room:
            raise OSError(28, "No space left on device")
        save(policy, folder)

    study, trainer = (
        study_at(tmp_path, tmp_path / "kept", budget=1),
        replace(COUNTING, save_fn=full),
    )
    with pytest.raises(StorageError, match=r"No space left.*memory of this process alone"):
        study.run(trainer=trainer, progress=False)
    assert not (tmp_path / "waiting").exists()
    assert not (tmp_path / "cache" / "mbtl").exists()
    room.append("free")
    study.run(trainer=trainer, progress=False)
    assert len(TRAINED) == len(study.state.rows) == 1


def lost(policy, folder):
    raise ZeroDivisionError("licence expired")


def test_a_policy_that_is_neither_saved_nor_sent_is_lost_for_the_reason_of_its_save(tmp_path):
    """Its worker once gave the reason why it could not be sent, and advised what was done."""
    trainer = FunctionTrainer(lambda context, seed: lambda: 1.0, evaluate, lost, load)
    job = Job(trainer, [SPACE.context(0)], 0, SPACE.contexts[:2], [1, 2], FolderStore(tmp_path))
    trouble = pickle.loads(pickle.dumps(perform_elsewhere(replace(job, places=[PLACE]))))
    assert trouble.kept is None
    with pytest.raises(StorageError, match=r"ZeroDivisionError.*could not send the policy back"):
        raise trouble.error


class Recipe(FunctionTrainer):
    """Another recipe, in another format."""

    def __init__(self, policy_format="custom", **recipe):
        super().__init__(train, evaluate, save, load, policy_format)
        object.__setattr__(self, "recipe", recipe)


def policies_in(folder):
    return sorted(path.parent.name for path in folder.rglob("x.txt"))


def test_functions_that_save_and_load_come_together_and_not_beside_a_trainer(tmp_path):
    study = study_at(tmp_path)
    with pytest.raises(InvalidInput, match="come together"):
        ran(study, train, evaluate, save=save)
    with pytest.raises(InvalidInput, match="functions or a trainer, got both"):
        study.run(train, evaluate, trainer=TRAINER)


@pytest.mark.parametrize("relative", ["s.db", "sqlite:///s.db", "sqlite:///file:s.db?uri=true"])
def test_the_working_folder_may_change_while_a_study_runs(tmp_path, monkeypatch, relative):
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "here")
    study = study_at(relative)

    def wandering(context, seed):
        os.chdir(tmp_path / "there")
        return train(context, seed)

    ran(study, wandering, evaluate, save=save, load=load)
    assert study.portfolio(TRAINER).policy(1) == pytest.approx(study.portfolio(TRAINER).policy(1))
    assert not any((tmp_path / "there").iterdir())
    assert len(policies_in(tmp_path / "here")) == 2


def test_the_file_behind_a_url():
    for address, file in (
        ("sqlite:////data/s.db", "/data/s.db"),
        ("sqlite:///file:/data/a%20b.db?mode=ro&uri=true", "/data/a b.db"),
        ("sqlite:///file:///data/s.db?uri=true", "/data/s.db"),
        ("sqlite:///file:s?mode=memory&uri=true", None),
        ("sqlite://", None),
        ("duckdb:////data/s.duckdb", "/data/s.duckdb"),
        ("postgresql://host/studies", None),
        ("no url", None),
    ):
        found = database.database_file(address)
        assert (None if found is None else found.as_posix()) == file


def test_a_database_that_is_no_file_needs_artifacts(tmp_path, monkeypatch):
    monkeypatch.setattr(artifacts, "database_file", lambda address: None)  # as of a server
    study = study_at(tmp_path)
    with pytest.warns(UnsavedPolicies, match="give artifacts="):
        study.run(trainer=TRAINER)
    assert study.portfolio().policy_for({"x": 0.0}) is not None
    for storage in (tmp_path, None):
        other = study_at(storage, name="other", artifacts=tmp_path).run(trainer=TRAINER).study
        assert all(row.policy for row in other.state.rows)


def test_a_policy_is_on_the_disk_before_its_row_is_told(tmp_path, monkeypatch):
    order = []
    monkeypatch.setattr(artifacts, "sync_folder", lambda f: order.append(policies_in(f)))
    monkeypatch.setattr(artifacts, "sync_entries", lambda folder: order.append(folder.name))
    study = study_at(tmp_path, budget=1)
    tell, name = study.tell, f"source-{study.ask().source:04d}"
    monkeypatch.setattr(
        study, "tell", lambda *a, **facts: (order.append("told"), tell(*a, **facts))
    )
    study.release(study._pick(study.state.picks[0]))
    study.run(trainer=TRAINER)
    assert len(order[0]) == 1  # the policy, before it has its name
    assert order[1:] == [study.state.uid, "policies", tmp_path.name, "told"]
    (policy,) = policies_in(tmp_path)
    assert policy.startswith(f"{name}-")
    assert policy.endswith(study.state.picks[0].answered_by)


def test_the_recipe_enters_the_log_and_another_one_is_refused(tmp_path):
    study_at(tmp_path).run(trainer=Recipe("mlp", net=(64, 64), steps=10))
    again = mbtl.load_study(tmp_path)
    code = again.state.equipment.pop("code")
    assert code.keys() == {"train", "evaluate"}
    assert again.state.equipment == {
        "recipe": {"net": [64, 64], "steps": 10},
        "policy_format": "mlp",
        "abilities": [],
    }
    assert again.portfolio().policy_format == "mlp"
    again.extend(3)
    with pytest.raises(StudyMismatch, match=r"recipe\.steps was 10, got 20"):
        again.run(trainer=Recipe("mlp", net=(64, 64), steps=20))
    with pytest.raises(StudyMismatch, match="policy_format was 'mlp', got 'custom'"):
        again.run(trainer=Recipe(net=(64, 64), steps=10))
    assert len(again.run(trainer=Recipe("mlp", net=[64, 64], steps=10)).curve) == 3


def test_a_policy_left_by_a_killed_run_counts_only_with_its_own_recipe(tmp_path):
    def interrupted(policy, contexts, seed):
        raise KeyboardInterrupt

    study = study_at(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        study.run(trainer=replace(TRAINER, evaluate_fn=interrupted))
    assert len(policies_in(tmp_path)) == 1
    trained = []

    class Counting(Recipe):
        def train(self, contexts, seed, **asked):
            trained.append(seed)
            return super().train(contexts, seed)

    study.run(trainer=Counting(steps=20))
    assert len(trained) == 2
