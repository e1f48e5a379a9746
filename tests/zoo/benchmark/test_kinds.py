"""Transfer data: trainings of every kind, built in parts, and their files."""

from dataclasses import replace

import numpy as np
import pytest

from mbtl.errors import InvalidInput, StorageError, UnknownName
from mbtl.problems import get_cmdp
from mbtl.seeds import MATRIX_TRIAL, evaluation_seeds, training_seed
from mbtl.zoo.benchmark import kinds as building
from mbtl.zoo.benchmark.kinds import Kinds
from mbtl.zoo.benchmark.matrix import TransferMatrix
from mbtl.zoo.benchmark.transfers import load_transfers, transfer_ids

IDS = ("pendulum-length", "pendulum-mass")
SMALL = {"n_envs": 2, "n_steps": 64, "batch_size": 64}


def build(folder, ids=IDS, monkeypatch=None, **more):
    cmdps = tuple(get_cmdp(name).every(25) for name in ids)
    options = {"timesteps": 1280, "hyperparameters": SMALL, "eval_episodes": 4}
    trainers = tuple(cmdp.trainer_for("quick", **options) for cmdp in cmdps)
    return Kinds(cmdps, trainers, (0, 1), folder, every=2, lanes=100, **more)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kinds")
    patch = pytest.MonkeyPatch()
    patch.setattr(building, "GENERALIST_UNITS", (0.5, 1.0, 2.0))
    with patch.context():
        one = build(folder, parents=(1.0,))
        one.run()
        one.refer()
        files = one.save(folder / "out", "the command", "quick")
        yield one, files


def test_all_kinds_of_all_cmdps_and_seeds_are_there(built):
    one, files = built
    assert [file.name for file in files] == [f"{name}-seed{s}.npz" for name in IDS for s in (0, 1)]
    folder = files[0].parent
    assert transfer_ids(folder) == list(IDS)
    data = load_transfers("pendulum-mass", folder=folder)
    assert data.sources.tolist() == [0, 2]
    assert data.contexts[:, 0].tolist() == data.space.values("mass")
    assert data.specialists.shape == (2, 2, 2, 4)
    assert {units: rows.shape for units, rows in data.generalists.items()} == dict.fromkeys(
        (0.5, 1.0, 2.0), (2, 2, 4)
    )
    assert {pair: rows.shape for pair, rows in data.tuned.items()} == dict.fromkeys(
        ((1.0, 0.5), (1.0, 1.0)), (2, 2, 2, 4)
    )
    assert {kind: each.shape for kind, each in data.std.items()} == {
        "specialists": (2, 2, 4), "generalists": (3, 2, 4), "tuned": (2, 2, 2, 4),
    }  # fmt: skip
    assert set(data.references) >= {"random_actions"}
    assert (data.episodes, data.unit_steps) == ((2, 2), 1280)
    assert data.space == one.cmdps[1].space
    assert data.bounds == one.cmdps[1].normalisation
    assert data.provenance[1]["seed"] == 1
    assert data.provenance[0]["together"] == list(IDS)


def test_each_number_is_of_the_training_and_the_episodes_that_it_says(built):
    """Against trainings one by one; another number of policies is another program."""
    one, files = built
    data = load_transfers("pendulum-mass", folder=files[0].parent)
    cmdp, trainer = one.cmdps[1], one.trainers[1]
    contexts = list(cmdp.space.contexts)
    own = evaluation_seeds(1, MATRIX_TRIAL, range(4))

    def halves(policy):
        returns = trainer.evaluate(policy, contexts, own)
        return np.stack([returns[:, :2].mean(axis=1), returns[:, 2:].mean(axis=1)])

    policy = trainer.train([contexts[2]], training_seed(1, MATRIX_TRIAL, 2)).policy
    np.testing.assert_allclose(data.specialists[1, :, 1], halves(policy), rtol=2e-3)
    seed = training_seed(1, MATRIX_TRIAL, range(4))
    policy = trainer.train(contexts, seed, length=0.5).policy
    np.testing.assert_allclose(data.generalists[0.5][1], halves(policy), rtol=2e-3)


def test_an_interrupted_build_goes_on_where_it_was(built, tmp_path, monkeypatch):
    monkeypatch.setattr(building, "GENERALIST_UNITS", (0.5, 1.0, 2.0))
    whole, _ = built
    one = build(tmp_path, parents=(1.0,))
    part = one.parts(("generalists",))[0]
    keep = Kinds._keep

    def killed(self, part, mark, policies):
        if mark == 2.0:
            raise KeyboardInterrupt
        keep(self, part, mark, policies)

    monkeypatch.setattr(Kinds, "_keep", killed)
    with pytest.raises(KeyboardInterrupt):
        one.train(part)
    monkeypatch.setattr(Kinds, "_keep", keep)
    one.train(part)
    for mark in (0.5, 1.0, 2.0):
        mine, theirs = one._actor(part, mark), whole._actor(part, mark)
        np.testing.assert_array_equal(mine.network[0][0], theirs.network[0][0])


def test_the_command_builds_the_kinds_asked_for_in_their_folder(mbtl_command, monkeypatch):
    monkeypatch.setattr(building, "GENERALIST_UNITS", (1.0, 2.0))
    given = "matrix build pendulum-length --with pendulum-mass --preset quick --every 50"
    own = "--lanes 100 --timesteps 2048 --eval-episodes 2 --seeds 1 --until 1 --kinds"
    build = (*given.split(), *own.split())
    first = mbtl_command.refusal(*build, "generalists")  # no matrix of such a recipe
    assert "build the kind specialists" in first
    assert "holds transfer data" in mbtl_command.refusal(*build, "all", "--lanes", 1)
    one, _ = mbtl_command.document(*build, "specialists")["transfers"]
    assert one["kinds"] == ["generalists", "specialists"]
    data = load_transfers("pendulum-length", folder="matrices/transfers")
    assert (list(data.generalists), data.tuned) == ([1.0], {})
    assert "--kinds generalists,specialists --until 1.0" in data.provenance[0]["command"]
    mbtl_command.done(*build, "generalists", "--until", 2)
    longer = load_transfers("pendulum-length", folder="matrices")
    with pytest.raises(InvalidInput, match=r"every kind are read by mbtl\.load_transfers"):
        TransferMatrix.load("matrices/transfers/pendulum-length-seed0.npz")
    assert list(longer.generalists) == [1.0, 2.0]
    np.testing.assert_array_equal(longer.generalists[1.0], data.generalists[1.0])


def test_copies_need_their_parents(tmp_path):
    one = build(tmp_path, ids=IDS[:1])
    with pytest.raises(InvalidInput, match="build the kind generalists first"):
        one.train(one.parts(("tuned",))[0])


def test_a_build_that_ends_before_there_are_parents_may_go_on(tmp_path):
    whole = build(tmp_path, ids=IDS[:1])
    short = replace(whole, until=0.5)
    assert {part.kind for part in short.parts()} == {"generalists", "specialists"}
    assert short.claim == whole.claim


def test_what_differs_in_more_than_contexts_is_not_built_together(tmp_path):
    one = build(tmp_path)
    other = replace(one.trainers[1], timesteps=2560)
    with pytest.raises(InvalidInput, match="one world, recipe and number of contexts"):
        replace(one, trainers=(one.trainers[0], other))
    with pytest.raises(UnknownName, match="kind of training"):
        one.parts(("committees",))


def test_files_of_different_builds_do_not_pass_for_seeds_of_one(built, tmp_path):
    _, files = built
    for file in files[:2]:
        (tmp_path / file.name).write_bytes(file.read_bytes())
    arrays = dict(np.load(tmp_path / files[1].name))
    np.savez(tmp_path / files[1].name, **{**arrays, "sources": arrays["sources"] + 1})
    with pytest.raises(StorageError, match="must agree on sources, and seed 1 does not"):
        load_transfers(IDS[0], folder=tmp_path)
    with pytest.raises(UnknownName, match="transfer data"):
        load_transfers("pendulum-mess", folder=tmp_path)
