"""`mbtl matrix build` on a user's own problem, and what other commands say of its files."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from mbtl.contexts import Categorical, ContextSpace, Linear
from mbtl.problems import CMDP, Preset
from mbtl.trainers import Trained, Trainer
from mbtl.zoo.benchmark import TransferMatrix, load_matrix


def train(context, seed):
    if STOP.exists() and context["length"] == 3.0:
        raise KeyboardInterrupt
    with LOG.open("a") as log:
        log.write(f"{context['length']}\n")
    return context["length"]


def evaluate(policy, contexts, seeds):
    return [100.0 - 10.0 * abs(policy - c["length"]) for c in contexts]


LOG, STOP = Path("trained.txt"), Path("stop")
mine = CMDP.from_functions(
    "cartpole-length", ContextSpace.grid({Linear("length", 1, 4): [1, 2, 3, 4]}),
    train=train, evaluate=evaluate, bounds=(0.0, 100.0), theta=0.1,
)  # fmt: skip


@dataclass(frozen=True)
class Kept(Trainer):
    timesteps: int = 5
    eval_episodes: int = 2

    @property
    def recipe(self):
        return {"timesteps": self.timesteps, "eval_episodes": self.eval_episodes}

    def train(self, contexts, seed, **asked):
        return Trained(train(contexts[0], seed))

    def evaluate(self, policy, contexts, seeds):
        return np.zeros((len(contexts), self.eval_episodes))

    def save(self, policy, folder):
        (folder / "policy.json").write_text(json.dumps(policy))
        return True

    def load(self, folder):
        return json.loads((folder / "policy.json").read_text())


kept = CMDP("cartpole-length", mine.space, Kept(), bounds=(-9.0, 0.0), presets={"full": Preset(4)})

sizes = ContextSpace.grid({Linear("wind", 0, 1): 4, Categorical("size", ("small", "large")): 2})
levels = CMDP.from_functions("levels", sizes, train=train, evaluate=evaluate)
OWN, KEPT, LEVELS = (f"{__file__}:{name}" for name in ("mine", "kept", "levels"))


BUILD = ("matrix", "build", OWN, "--workers", 1)


def test_a_users_problem_becomes_matrix_files(mbtl_command, tmp_path):
    code, out, err = mbtl_command(*BUILD, "--seeds", 2, "--json")
    assert code == 0, err
    assert [one["file"] for one in json.loads(out)["matrices"]] == [
        f"matrices/cartpole-length-seed{seed}.npz" for seed in range(2)
    ]
    matrix = load_matrix("cartpole-length", folder=tmp_path / "matrices")
    x = np.arange(4.0)
    np.testing.assert_allclose(matrix.performance(1), 1.0 - 0.1 * abs(x[:, None] - x))
    assert (matrix.theta, matrix.bounds.high) == (0.1, 100.0)
    record = matrix.provenance["seeds"][1]
    assert record["command"] == f"mbtl matrix build {OWN} --seeds 1 --first-seed 1"
    (origin,) = record["origins"]
    assert (origin["versions"]["numpy"], origin["sources"]) == (np.__version__, 4)
    assert matrix.episodes == (1,)
    assert matrix.std is None
    assert record["recipe"] == {"trainer": "FunctionTrainer"}
    assert record["problem"] == "cartpole-length"
    assert record["evaluation_seeds"] == matrix.evaluation_seeds == "per target"
    assert "evaluation seeds per target" in err
    assert "random policy 0.8750, Independent 1.0000" in err


def test_an_interrupted_build_goes_on(mbtl_command, tmp_path):
    (tmp_path / "stop").touch()
    assert "run the same command again" in mbtl_command.refusal(*BUILD, "--seeds", 1, code=130)
    (tmp_path / "stop").unlink()
    mbtl_command.done(*BUILD, "--seeds", 1)
    assert (tmp_path / "trained.txt").read_text().split() == ["1", "2", "3", "4"]
    code, _, err = mbtl_command(*BUILD, "--seeds", 1)
    assert code == 0
    assert "there already" in err
    assert len((tmp_path / "trained.txt").read_text().split()) == 4


def test_policies_are_evaluated_again_with_other_episodes_but_not_of_another_training(
    mbtl_command, tmp_path
):
    build = ("matrix", "build", KEPT, "--seeds", 1, "--workers", 1, "--preset", "full")
    again = (*build, "--evaluate-again", "--eval-episodes", 4)
    assert "no policies were kept" in mbtl_command.refusal(*again)
    mbtl_command.done(*build)
    assert load_matrix("cartpole-length", folder=tmp_path / "matrices").episodes == (1, 1)
    (claim,) = tmp_path.glob("runs/*/settings.json")
    older = json.loads(claim.read_text())
    del older["evaluation_seeds"]  # of before targets had their own: the policies are the same
    claim.write_text(json.dumps(older))
    mbtl_command.done(*again)
    evaluated = load_matrix("cartpole-length", folder=tmp_path / "matrices")
    assert (evaluated.episodes, evaluated.evaluation_seeds) == ((2, 2), "per target")
    assert len((tmp_path / "trained.txt").read_text().split()) == 4
    assert "recipe.timesteps was 5, got 7" in mbtl_command.refusal(*again, "--timesteps", 7)


def test_a_log_hears_of_a_long_build_now_and_then(mbtl_command, tmp_path, monkeypatch):
    monkeypatch.setattr("mbtl.cli.common.SILENCE", -1.0)
    assert "seed 0 sources: 3 of 4" in mbtl_command(*BUILD, "--seeds", 1)[2]
    monkeypatch.setattr("mbtl.cli.common.SILENCE", 3600.0)
    assert "sources" not in mbtl_command(*BUILD, "--seeds", 1, "--first-seed", 1)[2]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("matrix", "build", OWN, "--seeds", 0), "--seeds must be >= 1"),
        (("matrix", "build", OWN, "--checkpoint", "worst"), "best, final or both"),
        (("matrix", "build", OWN, "--visibility", "hidden"), "switches of our CMDPs"),
        (("matrix", "build", OWN, "--timesteps", 5), "takes no options"),
        (("matrix", "build", "cartpole-lenght"), "cartpole-length"),
        (("matrix", "build", OWN, "--with", "cartpole-mass"), "--with names CMDPs"),
        (("reproduce", "--budget", 0), "--budget must be >= 1"),
        (("reproduce", "--variant", "nothing"), "no matrices of the variant"),
        (("reproduce", "cartpole-lenght"), "cartpole-length"),
    ],
)
def test_bad_input_says_what_to_do(mbtl_command, tmp_path, arguments, complaint):
    assert complaint in mbtl_command.refusal(*arguments)


def test_show_and_list_say_of_what_the_numbers_are(mbtl_command, tmp_path):
    mbtl_command.done(*BUILD, "--seeds", 1)
    out = mbtl_command.done("matrix", "show", "matrices/cartpole-length-seed0.npz")
    assert "Performance 0 is a return of 0, 1 of 100" in out
    assert "same evaluation episodes" in " ".join(out.split())
    assert "Evaluation seeds are per target." in out
    assert "Evaluation seeds are common" in mbtl_command("matrix", "show", "cartpole-length")[1]
    assert mbtl_command("matrix", "list", "--folder", "matrices")[1].endswith("per target.\n")
    (one,) = mbtl_command.document("matrix", "list", "--folder", "matrices")["matrices"]
    said = (one["matrix"], one["measures_apart"], one["episodes"])
    assert said == ("cartpole-length", False, [1])


@pytest.mark.parametrize(
    ("record", "seeds"), [({"seeds": [{"seed": 4}, {"seed": 7}]}, [4, 7]), ({"seed": 7}, [0, 1])]
)
def test_show_numbers_seeds_as_their_provenance_does(mbtl_command, tmp_path, record, seeds):
    """But one number for two seeds says nothing."""
    TransferMatrix.of([np.eye(2)] * 2, provenance=record).save(tmp_path / "two.npz")
    rows = mbtl_command.document("matrix", "show", "two.npz")["seeds"]
    assert [row["seed"] for row in rows] == seeds


def test_show_knows_the_scale_of_the_paper_and_shows_any(mbtl_command, tmp_path):
    matrix = TransferMatrix.of(
        [[[-90.0, 10.0, 60.0]]], sources=[0], bounds=(-150, 300), contexts=[[8.0], [9.0], [10.0]],
        axes=["gravity"], provenance={"problem": "walker-gravity", "nominal": {"gravity": 10.0}},
    )  # fmt: skip
    matrix.save(tmp_path / "walker.npz")
    out = " ".join(mbtl_command("matrix", "show", "walker.npz")[1].split())
    assert "Performance 0 is a return of -150, 1 of 300" in out
    assert "In the paper 0 is -200 and 1 is 10; returns here are -90 to 60." in out
    assert "its policy is that of the nearest, gravity 8." in out
    for bounds, value in (("-200,10", 193.33 / 210), ("seen", 83.33 / 150)):
        shown = mbtl_command.document("matrix", "show", "walker.npz", "--bounds", bounds)
        assert shown["seeds"][0]["nominal_policy"] == pytest.approx(value, rel=1e-3)
    said = mbtl_command.refusal("matrix", "show", "walker.npz", "--bounds", "high")
    assert "--bounds is LOW,HIGH or seen, got 'high'" in said
    assert "-200..10" in mbtl_command("cmdps", "walker-gravity")[1]


def test_a_coarser_grid_is_a_set_of_its_own(mbtl_command, tmp_path):
    mbtl_command.done(*BUILD, "--seeds", 1, "--every", 2)
    matrix = load_matrix("cartpole-length", "every2", folder=tmp_path / "matrices")
    assert matrix.space.values("length") == [1, 3]
    assert matrix.theta == 0.2
    assert "--every 2" in matrix.provenance["seeds"][0]["command"]
    mbtl_command.refusal(*BUILD, "--every", 0)


def test_every_second_context_is_a_source(mbtl_command, tmp_path):
    build = (*BUILD, "--seeds", 1, "--sources-every", 2)
    mbtl_command.done(*build)
    assert (tmp_path / "trained.txt").read_text().split() == ["1", "3"]
    matrix = load_matrix("cartpole-length", folder=tmp_path / "matrices")
    np.testing.assert_array_equal(matrix.sources, [0, 2])
    np.testing.assert_allclose(matrix.rows(0, [2])[0], [0.8, 0.9, 1.0, 0.9])
    command = matrix.provenance["seeds"][0]["command"]
    assert command.endswith("--sources-every 2 --seeds 1 --first-seed 0")
    file = "matrices/cartpole-length-seed0.npz"
    assert "Trained on 2 of the 4 contexts" in mbtl_command.done("matrix", "show", file)
    assert "2/4" in mbtl_command("matrix", "list", "--folder", "matrices")[1]
    mbtl_command.done("bench", "--matrix", file, "--budget", 2)
    assert "has 2 sources and this build 4" in mbtl_command.refusal(*BUILD, "--seeds", 1)
    said = mbtl_command.refusal(*BUILD, "--seeds", 1, "--sources-every", 5)
    assert "--sources-every must be from 1" in said
    said = mbtl_command.refusal("matrix", "build", LEVELS, "--sources-every", 4)
    assert "got 4, which keeps none of size = large; take 3" in said


def test_trainings_of_every_kind_are_of_problems_in_jax(mbtl_command):
    said = mbtl_command.refusal(*BUILD, "--kinds", "all")
    assert "which FunctionTrainer trains; make it one (mbtl.engine.jax_problem), or" in said
    assert "own; leave engine out" in mbtl_command.refusal(*BUILD, "--engine", "jax")
    ours = ("matrix", "build", "cartpole-length", "--engine", "gymnasium", "--kinds", "all")
    assert "SB3Trainer trains; choose --engine jax, or" in mbtl_command.refusal(*ours)


@pytest.mark.parametrize(
    "record",
    [
        *({"seeds": odd} for odd in ("two", [1, 2], [{}])),
        {"seeds": [{"recipe": 3, "problem": [], "seed": "x"}, {"nominal": 1}]},
        {"nominal": {"x": "far"}},
        {"nominal": 5, "problem": ["a"], "recipe": "PPO"},
    ],
    ids=str,
)
def test_odd_provenance_breaks_no_command(mbtl_command, tmp_path, record):
    returns = np.random.default_rng(0).random((2, 4, 4))
    matrix = TransferMatrix.of(returns, contexts=np.arange(4.0)[:, None], provenance=record)
    matrix.save(tmp_path / "m.npz")
    assert matrix.records[0].get("problem", "") == matrix.cmdp == ""
    commands = [("matrix", "show", "m.npz")]
    if "seeds" not in record or isinstance(record["seeds"], list):
        commands.append(
            ["bench", "--matrix", "m.npz", "--budget", "2", "--selectors", "random,specialists"]
        )
    if "nominal" in record:
        commands.append(("report", "m.npz"))
    for command in commands:
        mbtl_command.done(*command)
