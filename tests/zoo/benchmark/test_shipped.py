"""The shipped layout: one file per seed, stacked again on reading."""

import numpy as np
import pytest

from mbtl.errors import InvalidInput, StorageError, UnknownName
from mbtl.zoo.benchmark import TransferMatrix, load_matrix, save_shipped, shipped_matrices
from mbtl.zoo.benchmark.shipped import open_matrices, open_matrix


@pytest.fixture
def matrix():
    returns = np.random.default_rng(2).normal(size=(3, 5, 5))
    return TransferMatrix.of(
        returns, std=np.abs(returns), bounds=(-4, 4), theta=0.003,
        contexts=np.linspace(0.1, 0.5, 5)[:, None], axes=["length"],
        provenance={"seeds": [{"wall_s": s, "command": "mbtl matrix build"} for s in range(3)]},
    )  # fmt: skip


def test_seeds_built_apart_are_stacked_in_order(tmp_path, matrix):
    for s in (10, 9):  # 9 sorts after 10 as text
        one = TransferMatrix.of(matrix.returns[:1] + s, provenance={"seed": s}, bounds=(0, 20))
        save_shipped(one, tmp_path, "pendulum-mass", first_seed=s)
    back = load_matrix("pendulum-mass", folder=tmp_path)
    assert [record["seed"] for record in back.provenance["seeds"]] == [9, 10]
    assert back.returns[0] == pytest.approx(matrix.returns[0] + 9, abs=1e-5)


def test_ids_are_listed_and_a_near_miss_is_answered(tmp_path, matrix):
    save_shipped(matrix, tmp_path, "cartpole-length")
    save_shipped(matrix, tmp_path, "cartpole-length", "dqn")
    assert shipped_matrices(tmp_path) == ["cartpole-length", "cartpole-length-dqn"]
    with pytest.raises(UnknownName, match="Did you mean 'cartpole-length'"):
        load_matrix("cartpole-lenght", folder=tmp_path)


@pytest.mark.parametrize("given", ["mine.npz", "."])
def test_a_path_is_no_id_and_is_sent_to_what_opens_files(given):
    with pytest.raises(InvalidInput, match=r"open a file with mbtl\.TransferMatrix\.load"):
        load_matrix(given)


def test_a_missing_matrix_says_how_to_get_one(tmp_path):
    with pytest.raises(UnknownName, match="holds none"):
        load_matrix("no-such-cmdp", folder=tmp_path)
    with pytest.raises(UnknownName, match=r"path of an \.npz"):
        open_matrix("no-such-cmdp")


def test_files_that_do_not_fit_together_are_refused(tmp_path, matrix):
    save_shipped(matrix, tmp_path, "a")
    save_shipped(TransferMatrix.of(matrix.returns[:1], bounds=(0, 1)), tmp_path, "a", first_seed=3)
    with pytest.raises(StorageError, match="agree on contexts"):
        load_matrix("a", folder=tmp_path)


def test_names_open_the_right_kind_and_must_be_distinct(tmp_path, matrix):
    matrix.save(tmp_path / "mine.npz")
    path = str(tmp_path / "mine.npz")
    opened = open_matrices([path, "synthetic:linear-gap", matrix])
    assert list(opened) == [path, "synthetic:linear-gap", "matrix"]
    with pytest.raises(InvalidInput, match="distinct names"):
        open_matrices([path, path])
    with pytest.raises(InvalidInput, match="one or more matrices"):
        open_matrices([])


def test_all_are_the_sets_of_one_axis():
    opened = open_matrices(["all"])
    assert {"cartpole-length", "pendulum-mass", "ring-vel"} <= set(opened)
    assert "cartpole-masses-length" in shipped_matrices()
    assert {source.space.d for source in opened.values()} == {1}


def test_matrices_of_traffic_name_their_score_and_version():
    names = [name for name in shipped_matrices() if name.startswith(("eco", "signal"))]
    assert len(names) == 9
    for name in names:
        matrix = open_matrix(name)
        assert {record["switches"]["score"] for record in matrix.records} == {"paper"}
        version = matrix.records[0]["version"]
        assert f"the paper's score of {matrix.cmdp} (--score paper, version {version})" in (
            matrix.caveat
        )
    assert load_matrix("cartpole-length").caveat is None
