"""Matrices by name: a user's file, a shipped matrix, or a synthetic world.

Synthetic ids are `synthetic:linear-gap` and `synthetic:<set>-<f>-<g>-<h>-eta<noise>`, e.g.
`synthetic:3d-lin-lin-nd-eta5`:

    set  1d, 3d, 5d, 7d
    f    source quality:    lin (rises along every axis) or const
    g    target difficulty: lin or none
    h    dissimilarity:     l1 (a distance) or nd, nd1, nd2, minor (directional on some axes)

`@<seeds>` at the end of a synthetic id gives the number of matrix seeds; without it there are 3, or
1 where there is no noise. The 3d, 5d and 7d sets are those of SD-MBTL (AAAI 2026); `minor` is the
case it leaves out, directional on fewer than half of the axes. The 1d set is ours: its slopes make
f, g and h span as much over 100 contexts as those of the 3d set, so that eta means the same share.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbtl.arrays import Array
from mbtl.benchmark.base import RowSource
from mbtl.benchmark.matrix import TransferMatrix
from mbtl.benchmark.npz import a_folder
from mbtl.benchmark.shipped import load_by_id, shipped_matrices
from mbtl.benchmark.synthetic import SyntheticWorld, linear_gap_world
from mbtl.errors import InvalidInput, unknown_name

PREFIX = "synthetic:"
_ALIKE = 21 / 99  # steps along all axes of the 3d set over steps along the 1d one


@dataclass(frozen=True)
class _Set:
    """One set of synthetic worlds: grid, slopes (return per grid step), and its variants."""

    shape: tuple[int, ...]
    quality: float
    difficulty: float
    right: float
    left: dict[str, tuple[float, ...]]
    etas: tuple[float, ...]
    scale: str
    qualities: tuple[str, ...] = ("const", "lin")


_SETS = {
    "1d": _Set(
        (100,), 4 * _ALIKE, 3 * _ALIKE, 3 * _ALIKE,
        {"l1": (-3 * _ALIKE,), "nd": (1 * _ALIKE,)},
        (0, 5, 15, 30), "all",
    ),
    "3d": _Set(
        (8,) * 3, 4, 3, 3,
        {"l1": (-3, -3, -3), "nd": (1, 1, -3), "minor": (1, -3, -3)},
        (0, 5, 15, 30), "all",
    ),
    "5d": _Set(
        (5,) * 5, 2, 2, 3,
        {"l1": (-3,) * 5, "nd1": (1, 1, 1, -3, -3), "nd2": (1, 1, 1, 1, -3)},
        (5,), "each",
    ),
    "7d": _Set(
        (4,) * 7, 0, 2, 3,
        {"l1": (-3,) * 7, "nd": (1, 1, 1, 1, 1, -3, -3)},
        (5,), "each", ("const",),
    ),
}  # fmt: skip


def synthetic_ids() -> list[str]:
    """Every named synthetic world; `eta<noise>` may be any number, `@<seeds>` may follow."""
    ids = [f"{PREFIX}linear-gap"]
    for key, family in _SETS.items():
        variants = itertools.product(family.qualities, ("none", "lin"), family.left, family.etas)
        ids += [f"{PREFIX}{key}-{f}-{g}-{h}-eta{eta:g}" for f, g, h, eta in variants]
    return ids


def synthetic_world(name: str) -> SyntheticWorld:
    """A synthetic world by id.

    Raises:
        UnknownName: no world has this id.
        InvalidInput: several seeds are asked of a world without noise.
    """
    match = re.fullmatch(
        rf"{PREFIX}(?:(?P<gap>linear-gap)|(?P<set>\dd)-(?P<f>\w+)-(?P<g>\w+)-(?P<h>\w+)"
        r"-eta(?P<eta>\d+(?:\.\d+)?))(?:@(?P<seeds>\d+))?",
        name,
    )
    if match is None or not (match["gap"] or _is_variant(match)):
        raise unknown_name(
            "synthetic world", name, synthetic_ids(),
            hint="mbtl.benchmark.synthetic_ids() lists all.",
        )  # fmt: skip
    n_seeds = int(match["seeds"]) if match["seeds"] else None
    if match["gap"]:
        return linear_gap_world(n_seeds=n_seeds, name=name)
    family, eta = _SETS[match["set"]], float(match["eta"])
    return SyntheticWorld(
        name=name,
        shape=family.shape,
        quality=family.quality * _steps(family.shape) if match["f"] == "lin" else 0.0,
        difficulty=family.difficulty * _steps(family.shape) if match["g"] == "lin" else 0.0,
        left=family.left[match["h"]],
        right=(family.right,) * len(family.shape),
        offset=500.0,
        noise=eta,
        n_seeds=n_seeds if n_seeds is not None else 3 if eta else 1,
        scale=family.scale,
    )


def open_matrix(name: str | Path) -> RowSource:
    """One matrix by name: `synthetic:...`, a path ending in .npz, or the id of a shipped matrix.

    Raises:
        UnknownName: nothing has this name.
        InvalidInput: the file cannot be used.
    """
    text = str(name)
    if text.startswith(PREFIX):
        return synthetic_world(text)
    if isinstance(name, Path) or text.endswith(".npz"):
        return TransferMatrix.load(text, name=text)
    if Path(text).is_dir() and text not in shipped_matrices():
        raise a_folder(Path(text))
    return load_by_id(text)


def open_matrices(names: Sequence[str | Path | RowSource]) -> dict[str, RowSource]:
    """Matrices by name, in order; objects keep their own name.

    "all" stands for every shipped set with one axis; those with several have ids of their own.

    Raises:
        InvalidInput: there is none, or two have the same name.
    """
    opened: list[tuple[str, RowSource]] = []
    for name in names:
        if name == "all":
            opened += _lines()
        elif isinstance(name, (str, Path)):
            opened.append((str(name), open_matrix(name)))
        else:
            opened.append((name.name, name))
    if not opened:
        raise InvalidInput(
            "a comparison needs one or more matrices, got none (this version may ship none); "
            "give the path of an .npz file or a synthetic id such as synthetic:linear-gap"
        )
    labels = [label for label, _ in opened]
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        raise InvalidInput(f"matrices must have distinct names, got {twice} more than once")
    return dict(opened)


def _lines() -> list[tuple[str, RowSource]]:
    opened = [(known, load_by_id(known)) for known in shipped_matrices()]
    return [(known, matrix) for known, matrix in opened if matrix.space.d == 1]


def _is_variant(match: re.Match[str]) -> bool:
    family = _SETS.get(match["set"])
    return (
        family is not None
        and match["f"] in family.qualities
        and match["g"] in ("none", "lin")
        and match["h"] in family.left
    )


def _steps(shape: tuple[int, ...]) -> Array:
    """(N,) steps from the first corner, summed over the axes."""
    positions = np.indices(shape).reshape(len(shape), -1)
    return np.asarray(positions.sum(axis=0), dtype=np.float64)
