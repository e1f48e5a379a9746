"""The paper's table: closed-form matrices in, known values out; the published numbers are there."""

import numpy as np
import pytest

from mbtl.benchmark import TransferMatrix, save_shipped
from mbtl.benchmark.multitask import load_multitask, save_multitask
from mbtl.benchmark.reproduction import METHODS, published, reproduce
from mbtl.errors import UnknownName

N = 6


@pytest.fixture
def folder(tmp_path):
    """Every policy returns 50 at home and 10 elsewhere, of bounds 0..100; two seeds."""
    returns = np.full((2, N, N), 10.0) + 40.0 * np.eye(N)
    matrix = TransferMatrix.of(
        returns, contexts=np.arange(1.0, N + 1)[:, None], axes=["length"], bounds=(0, 100)
    )
    save_shipped(matrix, tmp_path, "cartpole-length")
    for seed in range(2):
        row = np.full(N, 30.0 + 2 * seed)
        save_multitask(row, row / 10, {"s": seed}, tmp_path / "multitask", "cartpole-length", "ppo",
                       seed)  # fmt: skip
    return tmp_path


def test_published_numbers_of_all_22():
    table = published()
    assert len(table) == 22
    values, stars = table["cartpole-length"]
    assert set(values) == set(METHODS) - {"oracle_transfer"}
    assert (values["mbtl"].mean, values["mbtl"].std, stars) == (0.9717, 0.0148, 11.67)


def test_values_of_a_known_matrix(folder):
    (row,) = reproduce(["cartpole-length"], budget=3, folder=folder)
    after_three = (3 * 0.5 + 3 * 0.1) / 6
    for method in ("random", "greedy", "mbtl", "sequential_oracle"):
        assert row.ours[method].mean == pytest.approx(after_three)
        assert row.ours[method].std == pytest.approx(0.0)
    assert row.ours["independent"].mean == row.ours["oracle_transfer"].mean == pytest.approx(0.5)
    assert row.ours["multitask"].mean == pytest.approx(0.31)
    assert row.ours["multitask"].std == pytest.approx(0.02 / np.sqrt(2))  # n - 1
    assert (row.k_star, row.k_star_searched) == ((N, N), N)  # beyond K = 3
    assert row.references["random_policy"].mean == pytest.approx((50 + 5 * 10) / 600)
    assert "same evaluation episodes" in row.caveat
    assert (row.n, row.n_seeds, row.published["greedy"].mean) == (N, 2, 0.9424)


def test_greedy_is_left_out_where_it_cannot_run(tmp_path):
    contexts = [[a, b] for a in (0.0, 1.0, 2.0) for b in (0.0, 1.0)]
    matrix = TransferMatrix.of(np.eye(6)[None], contexts=contexts, axes=["a", "b"], bounds=(0, 1))
    save_shipped(matrix, tmp_path, "two-axes")
    (row,) = reproduce(["two-axes"], budget=6, folder=tmp_path)
    assert "greedy" not in row.ours
    assert row.ours["mbtl"].std is None  # of one seed there is no deviation
    assert row.ours["mbtl"].mean == row.ours["sequential_oracle"].mean == 1.0
    assert row.published == {}


def test_a_baseline_that_saw_something_else_is_no_peer(tmp_path):
    returns = np.full((1, N, N), 10.0)
    for variant, shown in (("default", "multiplier"), ("hidden", "hidden")):
        matrix = TransferMatrix.of(
            returns, bounds=(0, 100), provenance={"switches": {"visibility": shown}}
        )
        save_shipped(matrix, tmp_path, "cartpole-length", variant)
    record = {"switches": {"visibility": "multiplier"}}
    save_multitask(
        np.ones(N), np.ones(N), record, tmp_path / "multitask", "cartpole-length", "ppo", 0
    )
    for variant, expected in (("default", {"ppo"}), ("hidden", set())):
        (row,) = reproduce(budget=2, variant=variant, folder=tmp_path)
        assert set(row.multitask) == expected
        assert ("multitask" in row.ours) == bool(expected)


def test_where_policies_see_no_context_by_default_one_for_all_that_is_told_is_a_peer(tmp_path):
    switches = {"visibility": "hidden", "engine": "jax", "obs": "fresh"}
    matrix = TransferMatrix.of(
        np.full((1, N, N), 10.0), bounds=(0, 100), provenance={"switches": switches}
    )
    save_shipped(matrix, tmp_path, "ring-acc")
    save_shipped(matrix, tmp_path, "ring-acc", "final")
    for changes, peers in (({}, {"trpo"}), ({"obs": "stale"}, set())):
        record = {"switches": {**switches, "visibility": "multiplier", "engine": "sumo", **changes}}
        save_multitask(
            np.ones(N), np.ones(N), record, tmp_path / "multitask", "ring-acc", "trpo", 0
        )
        for variant in ("default", "final"):
            (row,) = reproduce(budget=2, variant=variant, folder=tmp_path)
            assert set(row.multitask) == peers


def test_only_cmdps_with_matrices_are_shown_and_others_refused(folder):
    assert [row.cmdp for row in reproduce(folder=folder, budget=2)] == ["cartpole-length"]
    with pytest.raises(UnknownName, match="pendulum-mass"):
        reproduce(["pendulum-mass"], folder=folder)


def test_multitask_files_go_round(folder):
    found = load_multitask("cartpole-length", folder=folder / "multitask")
    assert list(found) == ["ppo"]
    np.testing.assert_allclose(found["ppo"].returns, [[30.0] * N, [32.0] * N])
    np.testing.assert_allclose(found["ppo"].std[1], 3.2, rtol=1e-6)
    assert found["ppo"].provenance == ({"s": 0}, {"s": 1})
    assert load_multitask("cartpole-masscart", folder=folder / "multitask") == {}
