"""mbtl: choose which tasks to train on.

Model-based transfer learning for contextual reinforcement learning: train K of N contexts, chosen
one after another, and serve every context with the best of the trained policies.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbtl import errors, selectors, strategies
from mbtl.contexts import Categorical, Context, ContextSpace, Integer, Linear, Log
from mbtl.errors import (
    InvalidInput,
    MbtlError,
    StorageError,
    StudyError,
    TrainingFailed,
    TrainingPruned,
)
from mbtl.objective import Bounds, Objective
from mbtl.portfolio import Portfolio, load_portfolio
from mbtl.portfolio.archive import READERS
from mbtl.study import (
    Callback,
    Cost,
    Evaluation,
    Failures,
    Pick,
    Steps,
    Stopping,
    Study,
    StudyFinished,
    Workers,
    create_study,
    load_study,
)
from mbtl.trainer import FunctionTrainer
from mbtl.version import __version__

if TYPE_CHECKING:
    from mbtl.benchmark import TransferMatrix, load_matrix
    from mbtl.benchmark.compare import compare
    from mbtl.cmdps import CMDP, check_cmdp, get_cmdp

# outside the core: imported when first used, so that `import mbtl` stays light
_LAZY = {
    "CMDP": "mbtl.cmdps",
    "check_cmdp": "mbtl.cmdps",
    "get_cmdp": "mbtl.cmdps",
    "TransferMatrix": "mbtl.benchmark",
    "compare": "mbtl.benchmark",
    "load_matrix": "mbtl.benchmark",
}

__all__ = [
    "CMDP",
    "Bounds",
    "Callback",
    "Categorical",
    "Context",
    "ContextSpace",
    "Cost",
    "Evaluation",
    "Failures",
    "FunctionTrainer",
    "Integer",
    "InvalidInput",
    "Linear",
    "Log",
    "MbtlError",
    "Objective",
    "Pick",
    "Portfolio",
    "Steps",
    "Stopping",
    "StorageError",
    "Study",
    "StudyError",
    "StudyFinished",
    "TrainingFailed",
    "TrainingPruned",
    "TransferMatrix",
    "Workers",
    "__version__",
    "check_cmdp",
    "compare",
    "create_study",
    "errors",
    "get_cmdp",
    "load_matrix",
    "load_portfolio",
    "load_study",
    "plot",
    "selectors",
    "strategies",
]


def _read_sb3(folder: Path) -> Any:
    from mbtl.training import load_sb3  # needs the `train` extra

    return load_sb3(folder)


READERS["sb3"] = _read_sb3


def __getattr__(name: str) -> Any:
    if name in ("benchmark", "plot"):
        return importlib.import_module(f"mbtl.{name}")
    if name in _LAZY:
        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'mbtl' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
