"""Multi-task baselines: one policy trained on all contexts, its return on each.

A file is called `<cmdp>-<method>-seed<k>.npz` and holds one seed: `returns` and `std` over episodes
(N,), and its provenance. Methods: "ppo" (context-conditioned PPO), "ppo-x10" (with ten times the
steps), "paco", "moore".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import cannot_write
from mbtl.zoo.benchmark.npz import read_npz, read_text, text_array, write_npz
from mbtl.zoo.benchmark.shipped import data_folder, seed_files

FOLDER = "multitask"


@dataclass(frozen=True, eq=False)
class MultiTask:
    """One method on one CMDP.

    Attributes:
        returns: (S, N) mean raw return per seed and context.
        std: (S, N) standard deviation over episodes, with n - 1 (older files: n); 0 of one.
        provenance: one record per seed.
    """

    returns: Array
    std: Array
    provenance: tuple[Mapping[str, Any], ...]


def load_multitask(cmdp: str, *, folder: str | Path | None = None) -> dict[str, MultiTask]:
    """Methods stored for a CMDP, seeds stacked in order; empty if there are none.

    Args:
        cmdp: CMDP id.
        folder: where to look instead of the package data.
    """
    place = data_folder() / FOLDER if folder is None else Path(folder)
    methods = {
        name.removeprefix(f"{cmdp}-"): files
        for name, files in seed_files(place).items()
        if name.startswith(f"{cmdp}-")
    }
    return {method: _stack(files) for method, files in methods.items()}


def save_multitask(
    returns: Array,
    std: Array,
    provenance: Mapping[str, Any],
    folder: str | Path,
    cmdp: str,
    method: str,
    seed: int,
) -> Path:
    """Write one seed of one method, (N,) returns and standard deviations, as float32.

    Raises:
        StorageError: the place cannot be written.
    """
    place = Path(folder)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(place, error) from error
    path = multitask_file(place, cmdp, method, seed)
    write_npz(
        path,
        {
            "returns": np.asarray(returns, dtype=np.float32),
            "std": np.asarray(std, dtype=np.float32),
            "provenance": text_array(provenance),
        },
    )
    return path


def multitask_file(folder: Path, cmdp: str, method: str, seed: int) -> Path:
    """Where `save_multitask` writes."""
    return folder / f"{cmdp}-{method}-seed{seed}.npz"


def read_multitask(path: Path) -> MultiTask:
    """One file, as a method of one seed."""
    return _stack({0: path})


def _stack(files: Mapping[int, Path]) -> MultiTask:
    parts = [read_npz(files[seed]) for seed in sorted(files)]
    return MultiTask(
        np.stack([part["returns"].astype(np.float64) for part in parts]),
        np.stack([part["std"].astype(np.float64) for part in parts]),
        tuple(read_text(part["provenance"], "provenance") for part in parts),
    )
