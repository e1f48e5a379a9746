"""Transfer curves: rows along trainings, as matrices, in files, stacked, refused when wrong."""

import json

import numpy as np
import pytest

from mbtl.contexts import ContextSpace, Linear
from mbtl.errors import InvalidInput, StorageError, UnknownName
from mbtl.objective import Bounds
from mbtl.zoo.benchmark.curves import TransferCurves, load_curves

SPACE = ContextSpace.grid({Linear("x", 0.0, 2.0): [0.0, 1.0, 2.0]})
L, N, E = 4, 3, 5


def curves(seed=0, **changes):
    rng = np.random.default_rng(seed)
    entries = {
        "name": "toy",
        "space": SPACE,
        "bounds": Bounds(0.0, 100.0),
        "theta": 0.01,
        "provenance": {"seed": seed},
    }
    returns = rng.uniform(0.0, 100.0, (2, L, N, N, E))
    made = TransferCurves.of_episodes(
        returns, np.array([800, 300, 800]), [100, 200, 400, 800], **entries | changes
    )
    return made, returns


def test_steps_are_those_that_were_done():
    made, _ = curves()
    assert made.steps.tolist() == [
        [[100, 100, 100], [200, 200, 200], [400, 300, 400], [800, 300, 800]]
    ]


def test_a_length_is_a_transfer_matrix_with_two_halves():
    made, returns = curves()
    matrix = made.matrix(1, "last")
    assert np.allclose(matrix.returns[0], returns[1, 1, ..., :2].mean(axis=-1), atol=1e-4)
    assert np.allclose(matrix.fresh_returns[0], returns[1, 1, ..., 2:].mean(axis=-1), atol=1e-4)
    assert matrix.episodes == (2, 3)
    assert "after 200 steps (last)" in matrix.name


def test_a_file_reads_back_within_half_precision(tmp_path):
    made, _ = curves()
    made.save(tmp_path / "toy-seed0.npz")
    again = TransferCurves.load(tmp_path / "toy-seed0.npz")
    assert np.array_equal(again.lengths, made.lengths)
    assert np.array_equal(again.steps, made.steps)
    for kind in ("best", "last"):
        assert np.allclose(again.returns[kind], made.returns[kind], rtol=1e-3)
    assert (again.space, again.bounds, again.theta, again.episodes, again.unit) == (
        SPACE, made.bounds, 0.01, (2, 3), "steps",
    )  # fmt: skip
    assert again.provenance == {"seed": 0}


def test_the_files_of_seeds_are_stacked(tmp_path):
    for seed in (0, 1):
        curves(seed)[0].save(tmp_path / f"toy-hidden-seed{seed}.npz")
    stacked = load_curves("toy", "hidden", folder=tmp_path)
    assert stacked.n_seeds == 2
    assert stacked.matrix(-1).n_seeds == 2
    with pytest.raises(UnknownName, match="toy-hidden"):
        load_curves("toy", folder=tmp_path)
    curves(2, theta=0.02)[0].save(tmp_path / "toy-hidden-seed2.npz")
    with pytest.raises(StorageError, match="must agree"):
        load_curves("toy", "hidden", folder=tmp_path)


def test_wrong_files_are_refused_with_the_rule(tmp_path):
    made, returns = curves()
    path = tmp_path / "toy-seed0.npz"
    made.save(path)
    arrays = dict(np.load(path))
    broken = {
        "lengths must be whole numbers": {"lengths": np.array([400, 200, 100, 800])},
        r"steps must have shape \(seed, length, source\)": {"steps": arrays["steps"][:, :2]},
        "returns must have shape": {"best_returns": arrays["best_returns"][:, :2]},
        "must be finite": {"last_returns": np.full_like(arrays["last_returns"], np.nan)},
    }
    for message, change in broken.items():
        np.savez(path, **arrays | change)
        with pytest.raises(InvalidInput, match=message):
            TransferCurves.load(path)
    del arrays["steps"]
    np.savez(path, **arrays)
    with pytest.raises(InvalidInput, match="steps"):
        TransferCurves.load(path)
    with pytest.raises(InvalidInput, match="two episodes or more"):
        TransferCurves.of_episodes(returns[..., :1], np.array([1] * N), [1, 2, 3, 4], name="x",
                                   space=SPACE, bounds=Bounds(0.0, 1.0), theta=0.1)  # fmt: skip
    with pytest.raises(UnknownName, match="kind of policy"):
        made.matrix(0, "worst")
    with pytest.raises(InvalidInput, match="index of 4 lengths"):
        made.matrix(4)


def test_what_is_shipped_is_that_of_the_matrix():
    """Curves and matrix are of the same trainings: at their end they agree within noise."""
    for name in shipped():
        made = TransferCurves.load(name)
        record = made.provenance
        assert record["recipe"]["eval_episodes"] >= made.episodes[0]
        assert json.dumps(record)
        assert (made.steps <= made.lengths[:, None]).all()


def shipped():
    from mbtl.zoo.benchmark.curves import FOLDER
    from mbtl.zoo.benchmark.shipped import data_folder

    return sorted((data_folder() / FOLDER).glob("*.npz"))
