"""Matrices of others: the numbering of their files is that of our contexts."""

import numpy as np
import pytest

from mbtl.benchmark import import_npy
from mbtl.errors import InvalidInput, UnknownName


def numbered(path, sizes):
    """Entries that tell the grid indices of source and target, numbered as SD-MBTL's scripts do."""
    strides = np.cumprod([1, *sizes[::-1][:-1]])[::-1]
    n = int(np.prod(sizes))
    indices = [tuple(i // strides % sizes) for i in range(n)]
    code = np.array([sum(100.0**q * k for q, k in enumerate(index)) for index in indices])
    np.save(path, code[:, None] + code[None] / 1e6)
    return indices


@pytest.mark.parametrize(
    ("layout", "sizes", "last"),
    [
        ("sd-mbtl-cartpole", (10, 10, 9), {"masspole": 0.2, "masscart": 2.0, "length": 1.0}),
        ("sd-mbtl-walker", (8, 8, 8), {"friction": 4.0, "scale": 48.0, "gravity": 16.0}),
    ],
)
def test_contexts_are_numbered_as_in_the_files(tmp_path, layout, sizes, last):
    indices = numbered(tmp_path / "trial0.npy", sizes)
    matrix = import_npy([tmp_path / "trial0.npy"] * 2, layout)
    assert (matrix.n, matrix.n_seeds) == (len(indices), 2)
    assert matrix.space.contexts[-1] == pytest.approx(last)
    axes = [axis.name for axis in matrix.axes]
    values = [np.unique(matrix.space.values(axis)) for axis in axes]
    for i in (0, 1, 17, 300, len(indices) - 1):
        expected = {a: v[k] for a, v, k in zip(axes, values, indices[i], strict=True)}
        assert matrix.space.contexts[i] == pytest.approx(expected)
        code = sum(100.0**q * k for q, k in enumerate(indices[i]))
        assert matrix.returns[0, i, 0] == pytest.approx(code)
    assert (matrix.rows(0, [0]).min(), matrix.rows(1, [matrix.n - 1]).max()) == (0.0, 1.0)


def test_files_that_are_no_matrices(tmp_path):
    grid = {"x": [1.0, 2.0]}
    np.save(tmp_path / "hole.npy", np.array([[1.0, np.nan], [0.0, 1.0]]))
    np.save(tmp_path / "text.npy", np.array([["a", "b"]]))
    np.save(tmp_path / "object.npy", np.array([{}, []], dtype=object), allow_pickle=True)
    (tmp_path / "junk.npy").write_bytes(b"\x93NUMPY junk")
    for name, says in [
        ("hole.npy", r"1 NaN or infinite of 4, the first at \[source 0, target 1\]"),
        ("text.npy", "array of numbers"),
        ("object.npy", "no pickled objects"),
        ("junk.npy", "must be an .npy"),
        ("none.npy", "there is no file"),
    ]:
        with pytest.raises(InvalidInput, match=says):
            import_npy([tmp_path / name], grid)
    with pytest.raises(InvalidInput, match="one or more"):
        import_npy([], grid)
    with pytest.raises(UnknownName, match="layout"):
        import_npy(["a.npy"], "nowhere")
