"""Policies are never lost: they are saved where the study says, whatever the process does then."""

import os
from dataclasses import replace

import pytest
from line_problem import SPACE, TRAINER, evaluate, load, save, train

import mbtl
from flat import created, ran
from mbtl.errors import InvalidInput, StudyMismatch, UnsavedPolicies
from mbtl.study import artifacts, database
from mbtl.trainers import FunctionTrainer


class Recipe(FunctionTrainer):
    """Another recipe, in another format."""

    def __init__(self, policy_format="custom", **recipe):
        super().__init__(train, evaluate, save, load, policy_format)
        object.__setattr__(self, "recipe", recipe)


def study_at(storage, **settings):
    settings = {"budget": 2, "bounds": (0.0, 1.0), "strategy": "random", **settings}
    return created(SPACE, storage=storage, load_if_exists=True, **settings)


def policies_in(folder):
    return sorted(path.parent.name for path in folder.rglob("x.txt"))


def test_functions_that_save_and_load_keep_the_policies(tmp_path):
    ran(study_at(tmp_path / "s.db"), train, evaluate, save=save, load=load)
    later = mbtl.load_study(tmp_path / "s.db")
    assert len(policies_in(tmp_path / "policies")) == 2
    policy = later.portfolio(TRAINER).policy(0)
    assert policy == SPACE.context(later.history.sources[0])["x"]
    with pytest.raises(InvalidInput, match="come together"):
        ran(later, train, evaluate, save=save)
    with pytest.raises(InvalidInput, match="functions or a trainer, got both"):
        later.run(train, evaluate, trainer=TRAINER)


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
    study = study_at(tmp_path / "s.db")
    with pytest.warns(UnsavedPolicies, match="give artifacts="):
        study.run(trainer=TRAINER)
    assert study.portfolio().policy_for({"x": 0.0}) is not None
    for storage in (tmp_path / "s.db", None):
        other = study_at(storage, name="other", artifacts=tmp_path).run(trainer=TRAINER).study
        assert all(row.policy for row in other.state.rows)


def test_a_policy_is_on_the_disk_before_its_row_is_told(tmp_path, monkeypatch):
    order = []
    monkeypatch.setattr(artifacts, "sync_folder", lambda f: order.append(policies_in(f)))
    monkeypatch.setattr(artifacts, "sync_entries", lambda folder: order.append(folder.name))
    study = study_at(tmp_path / "s.db", budget=1)
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
    study_at(tmp_path / "s.db").run(trainer=Recipe("mlp", net=(64, 64), steps=10))
    again = mbtl.load_study(tmp_path / "s.db")
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


def test_a_recipe_can_be_mended_until_it_has_made_a_policy(tmp_path):
    class Typo(Recipe):
        def train(self, contexts, seed, **asked):
            raise InvalidInput("no such hyperparameter")

    study = study_at(tmp_path / "s.db")
    with pytest.raises(InvalidInput, match="no such"):
        study.run(trainer=Typo(lerning_rate=1))
    study.run(trainer=Recipe(learning_rate=1))
    assert study.state.equipment["recipe"] == {"learning_rate": 1}


def test_a_policy_left_by_a_killed_run_counts_only_with_its_own_recipe(tmp_path):
    def interrupted(policy, contexts, seed):
        raise KeyboardInterrupt

    study = study_at(tmp_path / "s.db")
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
