"""Matrices that come with the library: one small file per CMDP, variant and seed.

A file is called `<cmdp>[-<variant>]-seed<k>.npz` and is a complete matrix of one seed: raw returns
of both halves of the episodes and their standard deviation as float32, reference rows, contexts,
bounds, theta, and its provenance.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np

from mbtl.benchmark.entries import Floats, same_sources
from mbtl.benchmark.matrix import TransferMatrix
from mbtl.benchmark.npz import write_npz
from mbtl.errors import InvalidInput, StorageError, unknown_name
from mbtl.plain import short

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
    return Path(str(resources.files("mbtl.benchmark") / "data"))


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
