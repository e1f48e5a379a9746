"""Commands on the jax engine, as small as they go: real training, real files."""

import json

import numpy as np
import pytest

from mbtl.zoo.benchmark import load_matrix
from mbtl.zoo.benchmark.multitask import load_multitask


def test_a_multitask_baseline_becomes_a_file_beside_the_matrices(mbtl_command, tmp_path):
    command = (
        "matrix", "multitask", "cartpole-length", "--timesteps", 13_000, "--eval-episodes", 1,
        "--seeds", 1,
    )  # fmt: skip
    (found,) = mbtl_command.document(*command)["baselines"]
    baseline = load_multitask("cartpole-length", folder="matrices/multitask")["ppo"]
    assert baseline.returns.shape == (1, 100)
    assert found["performance"] == pytest.approx(baseline.returns.mean() / 500)
    record = baseline.provenance[0]
    asked = "--timesteps 13000 --eval-episodes 1 --seeds 1 --first-seed 0"
    assert record["command"].endswith(asked)
    assert (record["version"], record["recipe"]["method"]) == (0, "ppo")
    assert found["evaluation_seeds"] == "per target"
    said = mbtl_command(*command)[2]
    assert "there already" in said
    assert "; evaluation seeds per target" in said
    mbtl_command.refusal("matrix", "multitask", "cartpole-length", "--seeds", 0)


@pytest.mark.long
def test_an_interrupted_multitask_baseline_keeps_its_policy(mbtl_command, tmp_path):
    pytest.importorskip("libsumo", reason="the traffic extra is not installed")
    pytest.importorskip("sb3_contrib", reason="the sb3 extra is not installed")
    command = (
        "matrix", "multitask", "ring-acc", "--engine", "sumo", "--preset", "quick",
        "--eval-episodes", 1, "--seeds", 1, "--episodes",
    )  # fmt: skip
    mbtl_command.done(*command, 1)
    (file,) = (tmp_path / "matrices/multitask").glob("*.npz")
    first = load_multitask("ring-acc", folder=file.parent)["trpo"]
    assert "was made by" in mbtl_command(*command, 2)[2]  # and is not shown as this one's
    file.unlink()  # as if it had been interrupted in the evaluation
    (trained,) = (tmp_path / "runs").glob("*/trained.json")
    record = json.loads(trained.read_text())
    trained.write_text(json.dumps({**record, "train_seconds_of_last_run": 123.4}))
    assert mbtl_command(*command, 1)[0] == 0
    again = load_multitask("ring-acc", folder=file.parent)["trpo"]
    assert again.returns == pytest.approx(first.returns)
    assert again.provenance[0]["training"]["train_seconds_of_last_run"] == 123.4
    file.unlink()
    assert "other settings: episodes was 1, got 2" in mbtl_command(*command, 2)[2]


@pytest.mark.long
def test_a_multitask_policy_of_a_twin_keeps_through_an_interruption(mbtl_command, tmp_path):
    command = (
        "matrix", "multitask", "ring-vel", "--preset", "quick", "--episodes", 2,
        "--eval-episodes", 1, "--seeds", 1,
    )  # fmt: skip
    mbtl_command.done(*command)
    (file,) = (tmp_path / "matrices/multitask").glob("ring-vel-trpo-seed0.npz")
    (first,) = load_multitask("ring-vel", folder=file.parent).values()
    recipe = first.provenance[0]["recipe"]
    assert (recipe["episodes"], recipe["hyperparameters"]["n_episodes"]) == (2, 1)
    assert recipe["contexts"] == "uniform, one per episode; by TRPO four, or all, in an update"
    assert "there already" in mbtl_command(*command, "--engine", "jax")[2]
    other = mbtl_command(*command, "--engine", "sumo")[2]
    assert "was made by" in other
    assert "switches.engine was 'jax', got 'sumo'" in other
    file.unlink()
    (trained,) = (tmp_path / "runs").glob("*/trained.json")
    written = trained.stat().st_mtime_ns
    assert mbtl_command(*command)[0] == 0
    assert trained.stat().st_mtime_ns == written
    (again,) = load_multitask("ring-vel", folder=file.parent).values()
    np.testing.assert_array_equal(again.returns, first.returns)


@pytest.mark.long
def test_both_checkpoints_of_all_hundred_sources(mbtl_command):
    """The smallest whole matrix of real training: 100 policies in four programs of 25."""
    command = (
        "matrix", "build", "pendulum-timestep", "--seeds", 1, "--recipe", "fast",
        "--eval-episodes", 1, "--checkpoint", "both", "--lanes", 25, "--workers", 1, "--timesteps",
    )  # fmt: skip
    mbtl_command.done(*command, 6_000)
    assert "there already" in mbtl_command(*command, 6_000)[2]
    said = mbtl_command.refusal(*command, 7_000)  # and is not shown as this one's
    assert "recipe.timesteps was 6000, got 7000" in said
    best = load_matrix("pendulum-timestep", folder="matrices")
    final = load_matrix("pendulum-timestep", "final", folder="matrices")
    assert best.returns.shape == final.returns.shape == (1, 100, 100)
    assert not np.array_equal(best.returns, final.returns)
    recipes = [m.provenance["seeds"][0]["recipe"]["checkpoint"] for m in (best, final)]
    assert recipes == ["best", "final"]
    assert best.bounds.low == -2200.0
