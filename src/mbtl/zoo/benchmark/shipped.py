"""Matrices that come with the library: one small file per CMDP, variant and seed.

A file is called `<cmdp>[-<variant>]-seed<k>.npz` and is a complete matrix of one seed: raw returns
of both halves of the episodes and their standard deviation as float32, reference rows, contexts,
bounds, theta, and its provenance.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import InvalidInput, StorageError, unknown_name
from mbtl.plain import short
from mbtl.zoo.benchmark.base import RowSource
from mbtl.zoo.benchmark.matrix import Floats, TransferMatrix, same_sources
from mbtl.zoo.benchmark.npz import a_folder, write_npz
from mbtl.zoo.benchmark.synthetic import SyntheticWorld, linear_gap_world

_FILE = re.compile(r"(?P<id>.+)-seed(?P<seed>\d+)\.npz")
DEFAULT = "default"


def matrix_id(cmdp: str, variant: str = DEFAULT) -> str:
    """The id of a shipped matrix: the CMDP's, followed by the variant unless it is the default."""
    return cmdp if variant == DEFAULT else f"{cmdp}-{variant}"


def shipped_file(folder: Path, cmdp: str, variant: str, seed: int) -> Path:
    """Where `save_shipped` writes the matrix of a seed."""
    return folder / f"{matrix_id(cmdp, variant)}-seed{seed}.npz"


def family_of(matrix: str) -> str:
    """What comes before the first "-" of an id: all CartPole variations are one family."""
    return matrix.split("-")[0]


def shipped_matrices(folder: str | Path | None = None) -> list[str]:
    """Ids of all matrices in the package data, or in `folder`, sorted."""
    return sorted(_files(folder))


def load_matrix(
    cmdp: str, variant: str = DEFAULT, *, folder: str | Path | None = None
) -> TransferMatrix:
    """A shipped matrix, its seed files stacked.

    Args:
        cmdp: CMDP id, e.g. "cartpole-length".
        variant: recipe, e.g. "hidden", "final", "dqn", "a2c".
        folder: where to look instead of the package data, e.g. of matrices you built yourself.

    Returns:
        The matrix; its provenance is {"seeds": [one record per seed]}.

    Raises:
        UnknownName: there is no such matrix.
        StorageError: its files do not fit together.
    """
    return load_by_id(matrix_id(cmdp, variant), folder=folder)


def load_by_id(name: str, *, folder: str | Path | None = None) -> TransferMatrix:
    """A shipped matrix by its id (`shipped_matrices`); see `load_matrix`."""
    files = _files(folder)
    if name not in files:
        where = "this version of mbtl ships" if folder is None else f"{folder} holds"
        hint = f"Known: {', '.join(sorted(files))}." if files else f"So far {where} none."
        if str(name).endswith(".npz") or Path(name).is_dir():
            raise InvalidInput(
                f"load_matrix takes the id of a shipped matrix, got the path {str(name)!r}; open a "
                "file with mbtl.TransferMatrix.load"
            )
        raise unknown_name(
            "transfer matrix", name, files, hint=f"{hint} Give the path of an .npz file."
        )
    by_seed = files[name]
    parts = [TransferMatrix.load(by_seed[seed], name=name) for seed in sorted(by_seed)]
    for seed, part in zip(sorted(by_seed), parts, strict=True):
        difference = _difference(parts[0], part)
        if difference is not None:
            raise StorageError(
                f"the files of {name!r} must agree on {difference}, and seed {seed} does not; "
                "build it again"
            )
    return replace(
        parts[0],
        returns=np.concatenate([part.returns for part in parts]),
        fresh_returns=_stacked([part.fresh_returns for part in parts]),
        std=_stacked([part.std for part in parts]),
        references={
            key: np.concatenate([part.references[key] for part in parts])
            for key in parts[0].references
        },
        provenance={"seeds": [dict(part.provenance) for part in parts]},
    )


def _difference(one: TransferMatrix, other: TransferMatrix) -> str | None:
    """What keeps two files from being seeds of one matrix; None if nothing does."""
    same = {
        "contexts": one.space == other.space,
        "sources": same_sources(one.sources, other.sources),
        "bounds": one.bounds == other.bounds,
        "theta": one.theta == other.theta,
        "deviations (std)": (one.std is None) == (other.std is None),
        "halves of episodes (fresh_returns)": one.measures_apart == other.measures_apart,
        "the number of episodes": one.episodes == other.episodes,
        "reference rows": set(one.references) == set(other.references),
    }
    return next((what for what, agree in same.items() if not agree), None)


def _stacked(entries: Sequence[Floats | None]) -> Floats | None:
    there = [entry for entry in entries if entry is not None]
    return np.concatenate(there) if there else None


def save_shipped(
    matrix: TransferMatrix,
    folder: str | Path,
    cmdp: str,
    variant: str = DEFAULT,
    *,
    first_seed: int = 0,
) -> list[Path]:
    """Write one file per seed in the shipped layout, as float32.

    Args:
        matrix: with provenance either of the whole, or {"seeds": [one record per seed]}.
        folder: created when missing.
        cmdp: CMDP id.
        variant: recipe.
        first_seed: number of the matrix's first seed; the others follow.

    Returns:
        The paths written.

    Raises:
        InvalidInput: the provenance lists another number of seeds.
        StorageError: the place cannot be written.
    """
    records = matrix.provenance.get("seeds", [matrix.provenance] * matrix.n_seeds)
    if not isinstance(records, Sequence) or len(records) != matrix.n_seeds:
        raise InvalidInput(
            f"provenance must have one record per seed ({matrix.n_seeds}), got {short(records)}"
        )
    place = Path(folder)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{place} cannot be created ({error.strerror or error})") from error
    paths, fresh = [], matrix.fresh_returns
    for s, record in enumerate(records):
        one = replace(
            matrix,
            returns=_small(matrix.returns, s),
            fresh_returns=None if fresh is None else _small(fresh, s),
            std=None if matrix.std is None else _small(matrix.std, s),
            references={key: _small(rows, s) for key, rows in matrix.references.items()},
            provenance=record,
        )
        paths.append(shipped_file(place, cmdp, variant, first_seed + s))
        write_npz(paths[-1], one.arrays())
    return paths


def _small(entry: Floats, seed: int) -> Floats:
    """One seed of an entry as float32."""
    return entry[seed : seed + 1].astype(np.float32)


def data_folder() -> Path:
    """Of what comes with the library."""
    return Path(str(resources.files("mbtl.zoo.benchmark") / "data"))


def seed_files(place: Path) -> dict[str, dict[int, Path]]:
    """Matrix id -> seed -> file, of the files in a folder."""
    found: dict[str, dict[int, Path]] = {}
    for path in sorted(place.glob("*.npz")):
        match = _FILE.fullmatch(path.name)
        if match:
            found.setdefault(match["id"], {})[int(match["seed"])] = path
    return found


def _files(folder: str | Path | None) -> dict[str, dict[int, Path]]:
    return seed_files(data_folder() if folder is None else Path(folder))


# ---- matrices by name: a user's file, a shipped matrix, or a synthetic world -----------------
#
# Synthetic ids are `synthetic:linear-gap` and `synthetic:<set>-<f>-<g>-<h>-eta<noise>`, e.g.
# `synthetic:3d-lin-lin-nd-eta5`:
#
#     set  1d, 3d, 5d, 7d
#     f    source quality:    lin (rises along every axis) or const
#     g    target difficulty: lin or none
#     h    dissimilarity:     l1 (a distance) or nd, nd1, nd2, minor (directional on some axes)
#
# `@<seeds>` at the end of a synthetic id gives the number of matrix seeds; without it there are 3,
# or 1 where there is no noise. The 3d, 5d and 7d sets are those of SD-MBTL (AAAI 2026); `minor` is
# the case it leaves out, directional on fewer than half of the axes. The 1d set is ours: its
# slopes make f, g and h span as much over 100 contexts as those of the 3d set, so that eta means
#     the same share.


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
            hint="synthetic_ids() of mbtl.zoo.benchmark lists all.",
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
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise InvalidInput(f"matrices are given in a list, got {short(names)}")
    opened: list[tuple[str, RowSource]] = []
    for name in names:
        if name == "all":
            opened += _lines()
        elif isinstance(name, (str, Path)):
            opened.append((str(name), open_matrix(name)))
        elif not hasattr(name, "problem"):
            raise InvalidInput(
                "a matrix is a path, an id or a TransferMatrix; transfer data are for "
                f"replay_trainings, got {type(name).__name__}"
            )
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
