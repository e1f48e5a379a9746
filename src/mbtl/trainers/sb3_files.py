"""Files of a Stable-Baselines3 policy.

    model.zip                   the library's own format
    sb3.json                    which algorithm and versions wrote it, and what stands between the
                                model and its environments (`mbtl.trainers.adapted`)
    weights.npz, policy.json    numpy copy of the acting network, where there is one (`export_mlp`)

Reading `model.zip` can execute code: the library keeps some settings in it as cloudpickle. Open
only files you trust; the numpy copy is always safe and needs no torch.
"""

from __future__ import annotations

import importlib.metadata
import json
from pathlib import Path
from typing import Any

from mbtl.errors import InvalidInput, MbtlError, StorageError
from mbtl.files import read_json
from mbtl.trainers.adapted import AdaptedPolicy, model_of, read_adapted
from mbtl.trainers.algorithms import algorithm_class
from mbtl.trainers.export import export_mlp
from mbtl.trainers.sb3_learning import isolated

MODEL_FILE = "model.zip"
RECORD_FILE = "sb3.json"


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
        **({"adapted": policy.record()} if isinstance(policy, AdaptedPolicy) else {}),
        "versions": {n: importlib.metadata.version(n) for n in ("stable-baselines3", "torch")},
    }
    (folder / RECORD_FILE).write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
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
        return read_adapted(model, record.get("adapted"))
    except MbtlError:
        raise
    except Exception as error:  # a damaged or foreign zip raises whatever its parts raise
        writer = record.get("versions", "unknown versions")
        raise StorageError(
            f"{folder} must hold a {RECORD_FILE} and {MODEL_FILE} that the installed versions can "
            f"read, got {error!r}; they were written with {writer}"
        ) from error
