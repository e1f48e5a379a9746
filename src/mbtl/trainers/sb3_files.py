"""Files of a Stable-Baselines3 policy.

    model.zip                   the library's own format
    sb3.json                    which algorithm and versions wrote it, and the adapter between the
                                model and its environments (`mbtl.trainers.adapted`)
    statistics.pkl              statistics of observations, where they are standardised
    weights.npz, policy.json    numpy copy of the acting network, where there is one (`export_mlp`)

Reading `model.zip` and `statistics.pkl` can execute code: they hold pickles. Open only
files you trust; the numpy copy is always safe and needs no torch.
"""

from __future__ import annotations

import json
import pickle
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mbtl.envs.adapter import Adapter
from mbtl.errors import InvalidInput, MbtlError, StorageError
from mbtl.files import read_json
from mbtl.trainers.adapted import AdaptedPolicy, around, model_of
from mbtl.trainers.algorithms import algorithm_class
from mbtl.trainers.export import export_mlp
from mbtl.trainers.sb3_learning import isolated
from mbtl.version import installed

MODEL_FILE = "model.zip"
RECORD_FILE = "sb3.json"
STATISTICS_FILE = "statistics.pkl"


def save_sb3(policy: Any, folder: Path) -> None:
    """Write a policy, without its replay buffer, and its numpy copy into the empty `folder`."""
    model = model_of(policy)
    model.save(folder / MODEL_FILE)
    kind = type(model)
    package = kind.__module__.partition(".")[0]
    record = {
        "kind": "stable-baselines3 policy",
        "algorithm": kind.__name__,
        "package": package,
        **({"adapted": asdict(policy.adapter)} if isinstance(policy, AdaptedPolicy) else {}),
        "versions": installed("stable-baselines3", "torch"),
    }
    (folder / RECORD_FILE).write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    if (statistics := getattr(policy, "statistics", None)) is not None:
        (folder / STATISTICS_FILE).write_bytes(pickle.dumps(statistics))
    exported = export_mlp(policy)
    if exported is not None:
        exported.save(folder)


def load_sb3(folder: Path | str, algorithm: str | type | None = None, device: str = "cpu") -> Any:
    """Read the full model from its zip. This can execute code: only for files you trust.

    Args:
        folder: what `SB3Trainer.save` wrote.
        algorithm: name or class; found in the folder when missing. A class of a user's own must be
            given.
        device: torch device for the weights.

    Raises:
        StorageError: files are missing or cannot be read with the installed versions.
        InvalidInput: the algorithm is a user's own and was not given.
        MissingExtra: the library is not installed.
    """
    folder = Path(folder)
    record: dict[str, Any] = {}
    try:
        found = read_json((folder / RECORD_FILE).read_text(encoding="utf-8"))
        record = found if isinstance(found, dict) else {}
        if algorithm is None and record["package"] not in ("stable_baselines3", "sb3_contrib"):
            raise InvalidInput(
                f"only algorithms of stable-baselines3 and sb3-contrib are found by name, got "
                f"{record['algorithm']!r} of {record['package']!r}; pass algorithm=<the class>"
            )
        kind = algorithm_class(record["algorithm"] if algorithm is None else algorithm)
        with isolated():  # the library seeds the global generators when it builds a model
            model = kind.load(folder / MODEL_FILE, device=device)
        file = folder / STATISTICS_FILE
        statistics = pickle.loads(file.read_bytes()) if file.exists() else None
        return around(model, Adapter(**record.get("adapted", {})), statistics)
    except MbtlError:
        raise
    except Exception as error:  # a damaged or foreign zip raises whatever its parts raise
        writer = record.get("versions", "unknown versions")
        raise StorageError(
            f"{folder} must hold a {RECORD_FILE} and {MODEL_FILE} that the installed versions can "
            f"read, got {error!r}; they were written with {writer}"
        ) from error
