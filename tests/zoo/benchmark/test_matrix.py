"""Transfer matrices: defaults, rules, and what a file gives back."""

import json

import numpy as np
import pytest

from mbtl.contexts import Categorical, ContextSpace, Linear, Log
from mbtl.errors import InvalidInput, StorageError
from mbtl.objective import Bounds
from mbtl.zoo.benchmark import TransferMatrix, load_matrix, save_shipped


@pytest.fixture
def returns():
    return np.random.default_rng(1).uniform(-3, 7, size=(2, 4, 4))


def test_defaults_are_those_of_the_contract(tmp_path, returns):
    np.savez(tmp_path / "m.npz", returns=returns)
    matrix = TransferMatrix.load(tmp_path / "m.npz")
    assert matrix.bounds == Bounds(returns.min(), returns.max(), "maximize")  # over all seeds
    assert matrix.theta == 0.005
    assert matrix.contexts.tolist() == [[0], [1], [2], [3]]
    assert matrix.std is None
    assert matrix.provenance == {}
    assert (matrix.n, matrix.n_seeds) == (4, 2)


def test_theta_of_a_large_matrix_is_half_a_performance_per_span():
    assert TransferMatrix.of(np.zeros((1, 101, 101))).theta == pytest.approx(0.5 / 100)
    assert TransferMatrix.of(np.zeros((1, 100, 100))).theta == 0.005
    assert TransferMatrix.of(np.zeros((1, 3, 3)), theta=0.02).problem(2).theta == 0.02


def test_performance_is_normalised_by_bounds_and_not_clipped():
    returns = np.array([[[0.0, 300.0], [-100.0, 600.0]]])
    matrix = TransferMatrix.of(returns, bounds=[0, 500])
    assert matrix.performance(0) == pytest.approx(np.array([[0, 0.6], [-0.2, 1.2]]))
    assert matrix.rows(0, [1, 0]) == pytest.approx(np.array([[-0.2, 1.2], [0, 0.6]]))


def test_minimised_returns_are_good_when_small():
    returns = np.array([[[1.0, 3.0], [2.0, 5.0]]])
    matrix = TransferMatrix.of(returns, direction="min")
    assert matrix.performance(0) == pytest.approx(np.array([[1, 0.5], [0.75, 0]]))
    assert matrix.oracle_transfer == pytest.approx([(1 + 0.5) / 2])


def test_target_weights_count_in_every_level():
    space = ContextSpace.grid({Log("x", 1, 10): 2}, weights=[3, 1])
    matrix = TransferMatrix.of([[[0.5, 0.1], [0.9, 0.3]]], space=space, bounds=(0, 1))
    assert matrix.independent == pytest.approx([0.75 * 0.5 + 0.25 * 0.3])
    assert matrix.oracle_transfer == pytest.approx([0.75 * 0.9 + 0.25 * 0.3])
    assert matrix.grand_mean == pytest.approx([0.75 * 0.7 + 0.25 * 0.2])


def test_a_grid_of_contexts_gives_grid_steps():
    contexts = np.array([[x, y] for x in (1.0, 10.0, 20.0) for y in (0.5, 0.6)])
    matrix = TransferMatrix.of(np.zeros((1, 6, 6)), contexts=contexts, axes=["mass", "length"])
    assert matrix.problem(2).steps.tolist() == [[i, j] for i in range(3) for j in range(2)]
    assert [axis.name for axis in matrix.axes] == ["mass", "length"]
    assert np.array_equal(matrix.contexts, contexts)


def matrices():
    """One of every kind, by what is special about it."""
    rng = np.random.default_rng(1)
    returns = rng.uniform(0.1, 0.9, (2, 4, 8)).astype(np.float32)
    square, bounds = returns[:, :, :4], (-5, 5)
    space = ContextSpace.grid({Log("mass", 0.1, 10, "kg"): 4}, weights=[1, 2, 3, 4])
    seeds = {"seeds": [{"command": f"mbtl matrix build \u00e9 {seed}"} for seed in range(2)]}
    yield TransferMatrix.of(
        square, space=space, bounds=bounds, theta=0.01, direction="min", std=square,
        provenance=seeds, name="everything told",
    )  # fmt: skip
    roads = ContextSpace.grid({Categorical("road", tuple("abcd")): tuple("abcd")})
    yield TransferMatrix.of(square, space=roads, bounds=bounds, name="categories")
    yield TransferMatrix.of(
        returns, fresh_returns=returns / 2, sources=[0, 2, 5, 7], bounds=bounds, name="few sources"
    )
    episodes = rng.normal(size=(2, 4, 4, 5)).astype(np.float32)
    yield TransferMatrix.of_episodes(
        episodes, references={"unguided": episodes[:, 1]}, bounds=bounds, name="episodes"
    )


@pytest.mark.parametrize("matrix", list(matrices()), ids=lambda matrix: matrix.name)
def test_files_give_back_everything(tmp_path, matrix):
    matrix.save(tmp_path / "m.npz")
    paths = save_shipped(matrix, tmp_path / "new", "mine", "hidden")
    assert [path.name for path in paths] == [f"mine-hidden-seed{seed}.npz" for seed in range(2)]
    shipped = load_matrix("mine", "hidden", folder=tmp_path / "new")
    assert (shipped.name, shipped.returns.dtype) == ("mine-hidden", np.float32)
    for again in (TransferMatrix.load(tmp_path / "m.npz"), shipped):
        for name in ("returns", "fresh_returns", "std", "sources"):
            found, wanted = getattr(again, name), getattr(matrix, name)
            assert (found is None) == (wanted is None), name
            assert found is None or found == pytest.approx(wanted, abs=1e-6), name
        assert again.space == matrix.space
        assert (again.bounds, again.theta) == (matrix.bounds, matrix.theta)
        assert again.episodes == matrix.episodes
        assert list(again.references) == list(matrix.references)
        for way, returns in matrix.references.items():
            assert again.references[way] == pytest.approx(returns, abs=1e-6)
        assert again.records == matrix.records


def test_a_stranger_reads_a_file_with_numpy_alone_and_categories_are_no_numbers(tmp_path):
    whole, categories, *_ = matrices()
    whole.save(tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz", allow_pickle=False) as entries:
        assert entries["contexts"].shape == (4, 1)
        assert str(entries["direction"]) == "min"
    with pytest.raises(InvalidInput, match="categorical"):
        _ = categories.contexts


def test_equal_matrices_give_equal_bytes(tmp_path, returns):
    for name in ("a.npz", "b.npz"):
        TransferMatrix.of(returns).save(tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_returns_cannot_be_changed_through_the_matrix_and_callers_keep_their_array(returns):
    matrix = TransferMatrix.of(returns)
    with pytest.raises(ValueError, match="read-only"):
        matrix.returns[0, 0, 0] = 1.0
    returns[0, 0, 0] = 1.0


GOOD = np.zeros((1, 3, 3))
THREE = json.dumps(ContextSpace.grid({Linear("x", 0, 2): 3}).to_json())
ODD_SOURCES = ([0, 2, 5], [0, 2, 7, 5], [0, 2, 5, 8], [-1, 2, 5, 7], [0.0, 2.0, 5.0, 7.0])


@pytest.mark.parametrize(
    ("entries", "match"),
    [
        ({}, "needs `returns`"),
        ({"returns": np.zeros((3, 3))}, r"returns\[None\]"),
        ({"returns": np.zeros((1, 3, 4))}, "as many sources as targets"),
        ({"returns": np.full((1, 3, 3), np.nan)}, "got nan at .* the first of 9 of 9"),
        ({"returns": np.where(np.eye(3) > 0, np.inf, 0)[None]}, "seed 0, source 0, target 0"),
        ({"returns": np.zeros((1, 2, 2), dtype=complex)}, "real numbers"),
        ({"returns": np.full((1, 2, 2), None)}, "no pickled objects"),
        ({"returns": GOOD, "bounds": [1, 0]}, "low < high"),
        ({"returns": GOOD, "Bounds": [0, 1]}, "holds 'Bounds'.* write it 'bounds'"),
        ({"returns": GOOD, "source": [0, 1, 2]}, "holds 'source'.* write it 'sources'"),
        ({"returns": GOOD, "theta": -1}, ">= 0"),
        ({"returns": GOOD, "direction": "up"}, "'max' or 'min'"),
        ({"returns": GOOD, "contexts": np.zeros((2, 1))}, "N = 3"),
        ({"returns": GOOD, "contexts": np.zeros((3, 1))}, "distinct"),
        ({"returns": GOOD, "contexts": [[1.0, "a"]] * 3}, "axes of categories .* as space="),
        ({"returns": GOOD, "contexts": [[0], [1], [2]], "axes": ["a", "b"]}, "1 names"),
        ({"returns": GOOD, "axes": ["a", "b"]}, "need `contexts`"),
        ({"returns": GOOD, "std": np.zeros((1, 3))}, "shape of returns"),
        ({"returns": GOOD, "std": -np.ones((1, 3, 3))}, "std must be deviations from 0"),
        ({"returns": GOOD, "space": '{"axes": 3}'}, "space"),
        ({"returns": GOOD, "space": THREE, "contexts": [[0], [1], [3]]}, "space say the same"),
        ({"returns": GOOD, "fresh_returns": np.zeros((1, 2, 2))}, "must have the shape"),
        ({"returns": GOOD, "fresh_returns": np.nan * GOOD}, "fresh_returns must be finite"),
        *(({"returns": GOOD, "episodes": odd}, "1 whole number") for odd in ([2, 3], [0])),
        ({"returns": GOOD, "reference_unguided": np.zeros((1, 2, 3))}, "reference_unguided must"),
        *(({"returns": np.zeros((1, 4, 8)), "sources": odd}, "sources") for odd in ODD_SOURCES),
        ({"returns": np.zeros((1, 4, 8))}, "sources"),
        ({"returns": GOOD, "provenance": "[1]"}, "JSON object"),
    ],
)
def test_a_bad_file_is_refused_with_its_name_and_the_rule(tmp_path, entries, match):
    path = tmp_path / "bad.npz"
    np.savez(path, **{key: np.asarray(value) for key, value in entries.items()})
    with pytest.raises(InvalidInput, match=match) as caught:
        TransferMatrix.load(path)
    assert "bad.npz" in str(caught.value)


def test_files_that_are_no_matrix_files(tmp_path):
    (tmp_path / "text.npz").write_text("hello")
    (tmp_path / "empty.npz").write_bytes(b"")
    with (tmp_path / "single.npz").open("wb") as file:
        np.save(file, GOOD)
    for name, words in (
        ("absent.npz", "no file"),
        ("text.npz", "plain numbers"),
        ("empty.npz", "damaged"),
        ("single.npz", "single array"),
        (".", r"is a folder; give one that it holds: empty\.npz, single"),
    ):
        with pytest.raises(InvalidInput, match=words):
            TransferMatrix.load(tmp_path / name)


def test_a_failed_write_leaves_no_file_and_keeps_the_old_one(tmp_path):
    matrix = TransferMatrix.of(GOOD)
    with pytest.raises(InvalidInput, match=r"ends in \.npz"):
        matrix.save(tmp_path / "m.csv")
    with pytest.raises(StorageError, match="cannot be written"):
        matrix.save(tmp_path / "absent" / "m.npz")
    (tmp_path / "m.npz").mkdir()
    with pytest.raises(StorageError, match="cannot be written"):
        matrix.save(tmp_path / "m.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["m.npz"]


def test_a_name_is_kept_on_saving_and_older_files_are_called_by_their_path(tmp_path):
    path = tmp_path / "m.npz"
    TransferMatrix.of(np.eye(3)[None], bounds=(0, 1), name="load").save(path)
    assert TransferMatrix.load(path).name == "load"
    assert TransferMatrix.load(path, name="other").name == "other"
    np.savez(path, returns=np.eye(3)[None])
    assert TransferMatrix.load(path).name == str(path)
    np.savez(path, returns=np.eye(3)[None], name=np.zeros(2))
    with pytest.raises(InvalidInput, match="name must be one text"):
        TransferMatrix.load(path)
