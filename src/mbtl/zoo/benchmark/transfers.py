"""What trainings of every kind returned on every context: transfer data.

A file is called `<cmdp>-seed<k>.npz` and holds one seed. Kinds of trainings, and their entries:

- `specialists` (half, source, target): whole trainings on one context from scratch.
- `generalists` (mark, half, target): one training on all contexts that is extended, at the marks
  `generalist_units`, which are the units paid so far.
- `tuned` (parent, mark, half, source, target): copies of the generalist of `tuned_parents` units,
  trained on one context for `tuned_units` units. A file may have none.

Half 0 of the episodes is to choose by, half 1 to report; each target has evaluation seeds of its
own, the same for all policies. `<kind>_std` has the deviation over all episodes, without the half.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array, Indices
from mbtl.contexts import ContextSpace
from mbtl.errors import InvalidInput, StorageError, check_known
from mbtl.objective import Bounds, direction_named
from mbtl.plain import array_of, real, refused, short
from mbtl.zoo.benchmark.matrix import REFERENCE, context_values, halves
from mbtl.zoo.benchmark.npz import read_npz, read_text, text_array, write_npz
from mbtl.zoo.benchmark.shipped import data_folder, seed_files

FOLDER = "transfers"
KINDS = ("specialists", "generalists", "tuned")
_SHARED = ("space", "sources", "bounds", "generalist_units", "tuned_parents", "tuned_units")
"""What the files of a CMDP must agree on."""


@dataclass(frozen=True, eq=False)
class TransferData:
    """Trainings of every kind on one CMDP, S seeds; M sources, N targets, two halves of episodes.

    Attributes:
        name: id of the CMDP.
        space: the N contexts.
        sources: (M,) indices of the contexts of specialists and tuned copies, rising.
        bounds: normalisation.
        episodes: of the two halves.
        specialists: (S, 2, M, N) mean raw returns of whole trainings from scratch.
        generalists: units -> (S, 2, N), of one training on all contexts that is extended.
        tuned: (parent's units, units) -> (S, 2, M, N), of copies tuned on one context.
        std: kind -> deviations over all episodes, of the same shapes without the half, units first
            where there are several: (S, M, N), (L, S, N) and (L', S, M, N), in the order of the
            mappings.
        references: name -> (S, 2, N), without any policy.
        unit_steps: environment steps, or episodes, of one unit.
        provenance: one record per seed.

    Raises:
        InvalidInput: shapes that do not fit together, numbers that are none, sources that are no
            rising indices of contexts, or units that are not rising.
    """

    name: str
    space: ContextSpace
    sources: Indices
    bounds: Bounds
    episodes: tuple[int, int]
    specialists: Array
    generalists: Mapping[float, Array]
    tuned: Mapping[tuple[float, float], Array]
    std: Mapping[str, Array]
    references: Mapping[str, Array]
    unit_steps: int
    provenance: tuple[Mapping[str, Any], ...]

    def __post_init__(self) -> None:
        sources, n = array_of("sources", self.sources), self.n
        listed = sources.ndim == 1 and sources.dtype.kind in "iu"
        rising = listed and (sources[1:] > sources[:-1]).all()
        if not (rising and sources.size and sources[0] >= 0 and sources[-1] < n):
            raise InvalidInput(
                f"sources are indices of contexts from 0 to {n - 1}, rising, got {short(sources)}"
            )
        marks, pairs = list(self.generalists), list(self.tuned)
        for units in itertools.chain(marks, *pairs):
            real("units of a training", units)
        if marks != sorted({*marks}):
            raise InvalidInput(f"units of generalists are rising, got {short(marks)}")
        m, s = sources.size, len(self.provenance)
        sizes: dict[str, tuple[int, ...]] = {
            "specialists": (s, m, n),
            "generalists": (len(marks), s, n),
            "tuned": (len(pairs), s, m, n),
        }
        held = {
            "sources": sources,
            "specialists": _numbers("specialists", self.specialists, (s, 2, m, n)),
            "generalists": {
                units: _numbers(f"generalists[{units:g}]", rows, (s, 2, n))
                for units, rows in self.generalists.items()
            },
            "tuned": {
                pair: _numbers(f"tuned[{few_units(pair)}]", rows, (s, 2, m, n))
                for pair, rows in self.tuned.items()
            },
            "std": {
                kind: _numbers(f"std of {kind}", self.std.get(kind), size)
                for kind, size in sizes.items()
                if 0 not in size
            },
        }
        for name, value in held.items():
            object.__setattr__(self, name, value)

    @property
    def n(self) -> int:
        """Number of contexts."""
        return self.space.n

    @property
    def contexts(self) -> Array:
        """(N, d) context values; `space.contexts` gives them as mappings.

        Raises:
            InvalidInput: an axis is categorical and has no numbers.
        """
        return context_values(self.space)

    @property
    def n_seeds(self) -> int:
        """Number of seeds."""
        return len(self.specialists)

    def __repr__(self) -> str:
        parents = sorted({parent for parent, _ in self.tuned})
        copies = f"copies tuned from {few_units(parents)}" if parents else "no copies"
        return (
            f"TransferData({self.name!r}, {self.n_seeds} seeds, {len(self.sources)} sources, "
            f"generalists at {few_units(list(self.generalists))} units, {copies})"
        )


def _numbers(name: str, given: Any, shape: tuple[int, ...]) -> Array:
    """An array of finite numbers."""
    array = array_of(name, given)
    wrong = array.dtype.kind not in "fiu" or array.shape != shape
    if wrong or refused(array).any():
        what = f"{array.dtype} of shape {array.shape}" if wrong else "NaN, or infinite ones"
        raise InvalidInput(f"{name} must be finite numbers of shape {shape}, got {what}")
    return array.astype(np.float64, copy=False)


def few_units(units: Sequence[float]) -> str:
    """As people write them."""
    return ", ".join(f"{one:g}" for one in units)


def transfer_ids(folder: str | Path | None = None) -> list[str]:
    """CMDPs with transfer data in the package, or in `folder`, sorted."""
    return sorted(_files(folder))


def load_transfers(cmdp: str, *, folder: str | Path | None = None) -> TransferData:
    """Transfer data of a CMDP, its seed files stacked.

    Args:
        cmdp: CMDP id, e.g. "cartpole-length".
        folder: where to look instead of the package data, itself or its folder `transfers`.

    Raises:
        UnknownName: there are none.
        StorageError: its files do not fit together.
    """
    files = _files(folder)
    check_known("transfer data", cmdp, files)
    by_seed = files[cmdp]
    parts = [read_npz(by_seed[seed]) for seed in sorted(by_seed)]
    first = parts[0]
    for seed, part in zip(sorted(by_seed), parts, strict=True):
        wrong = set(first.keys() ^ part.keys()) | {
            key
            for key in _SHARED
            if key in first and key in part and not np.array_equal(first[key], part[key])
        }
        if wrong:
            raise StorageError(
                f"the files of {cmdp!r} must agree on {min(wrong)}, and seed {seed} does not; "
                "build it again"
            )

    def stacked(key: str) -> Array:
        return np.stack([part[key].astype(np.float64) for part in parts])

    generalists = stacked("generalists")
    deviations = {
        "specialists": stacked("specialists_std"),
        "generalists": stacked("generalists_std").swapaxes(0, 1),
    }
    tuned: dict[tuple[float, float], Array] = {}
    if "tuned" in first:
        rows, scatter = stacked("tuned"), stacked("tuned_std")
        each = [(float(p), float(u)) for p in first["tuned_parents"] for u in first["tuned_units"]]
        flat = rows.reshape(len(parts), -1, *rows.shape[3:])
        tuned = {pair: flat[:, i] for i, pair in enumerate(each)}
        deviations["tuned"] = scatter.reshape(len(parts), -1, *scatter.shape[3:]).swapaxes(0, 1)
    low, high = (float(x) for x in first["bounds"])
    direction = direction_named(str(first["direction"]))
    floor = float(first["floor"]) if "floor" in first else None
    return TransferData(
        name=cmdp,
        space=ContextSpace.from_json(read_text(first["space"], "space")),
        sources=first["sources"].astype(np.intp),
        bounds=Bounds(low, high, direction, floor),
        episodes=(int(first["episodes"][0]), int(first["episodes"][1])),
        specialists=stacked("specialists"),
        generalists={
            float(units): generalists[:, i] for i, units in enumerate(first["generalist_units"])
        },
        tuned=tuned,
        std=deviations,
        references={
            key.removeprefix(REFERENCE): stacked(key) for key in first if key.startswith(REFERENCE)
        },
        unit_steps=int(first["unit_steps"]),
        provenance=tuple(read_text(part["provenance"], "provenance") for part in parts),
    )


def summary(episodes: NDArray[Any]) -> NDArray[np.float32]:
    """(..., E) returns of episodes -> (..., 3): means of the two halves, and the deviation.

    Raises:
        InvalidInput: there are less than two episodes.
    """
    total = episodes.shape[-1]
    if total < 2:
        raise InvalidInput(f"transfer data need two episodes or more, got {total}")
    deviation = episodes.std(-1, ddof=1, dtype=np.float64)
    return np.stack([*halves(episodes)[0], deviation], axis=-1).astype(np.float32)


def save_transfers(
    folder: str | Path,
    cmdp: Any,
    seed: int,
    returns: Mapping[str, NDArray[Any]],
    *,
    episodes: int,
    sources: Sequence[int],
    generalist_units: Sequence[float],
    tuned_parents: Sequence[float],
    tuned_units: Sequence[float],
    unit_steps: int,
    provenance: Mapping[str, Any],
) -> Path:
    """Write one seed as float32.

    Args:
        folder: made where it is missing.
        cmdp: the problem.
        seed: of the file.
        returns: `specialists` (M, N, 3), `generalists` (L, N, 3), `tuned` (P, U, M, N, 3) where
            there are copies, and `reference_<name>` (N, 3), as of `summary`.
        episodes: of each, E.
        sources: (M,) indices of contexts.
        generalist_units: (L,) marks of the generalist.
        tuned_parents: (P,) units of the parents.
        tuned_units: (U,) marks of the copies.
        unit_steps: environment steps, or episodes, of a unit.
        provenance: JSON-able.
    """
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    path = place / f"{cmdp.id}-seed{seed}.npz"
    arrays: dict[str, NDArray[Any]] = {}
    for name, each in returns.items():
        before = {"generalists": 1, "tuned": 2}.get(name, 0)
        arrays[name] = np.moveaxis(each[..., :2], -1, before)
        if not name.startswith(REFERENCE):
            arrays[f"{name}_std"] = each[..., 2]
    bounds = cmdp.normalisation
    arrays |= {
        "space": text_array(cmdp.space.to_json()),
        "sources": np.asarray(sources, np.int64),
        "bounds": np.array([bounds.low, bounds.high]),
        "direction": np.array("max" if bounds.direction == "maximize" else "min"),
        "episodes": np.array(halves(np.zeros(episodes))[1]),
        "generalist_units": np.asarray(generalist_units, np.float64),
        "tuned_parents": np.asarray(tuned_parents, np.float64),
        "tuned_units": np.asarray(tuned_units, np.float64),
        "unit_steps": np.array(unit_steps),
        "provenance": text_array(provenance),
    }
    if bounds.floor is not None:
        arrays["floor"] = np.array(bounds.floor)
    write_npz(path, arrays)
    return path


def _files(folder: str | Path | None) -> dict[str, dict[int, Path]]:
    place = data_folder() if folder is None else Path(folder)
    return seed_files(place / FOLDER if (place / FOLDER).is_dir() else place)
