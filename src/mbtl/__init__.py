"""mbtl: choose which tasks to train on.

Model-based transfer learning for contextual reinforcement learning: train K of N contexts, chosen
one after another, and serve every context with the best of the trained policies.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbtl import selectors
from mbtl.contexts import Categorical, Context, ContextSpace, Integer, Linear, Log
from mbtl.errors import (
    CheckFailed,
    ContextMismatch,
    InvalidInput,
    MbtlError,
    MissingExtra,
    Notice,
    SimulationFailed,
    StorageError,
    StudyError,
    StudyMismatch,
    TrainingFailed,
    TrainingPruned,
    UnknownName,
    Unreachable,
    UnsavedPolicies,
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
    RunResult,
    Steps,
    Stopping,
    Study,
    StudyFinished,
    Training,
    Workers,
    create_study,
    delete_study,
    list_studies,
    load_study,
)
from mbtl.version import __version__

if TYPE_CHECKING:
    from mbtl.benchmark import TransferMatrix, load_curves, load_matrix
    from mbtl.benchmark.compare import compare
    from mbtl.cmdps import CMDP, check_cmdp, get_cmdp

# outside the core: imported when first used, so that `import mbtl` stays light
_LAZY = {
    "CMDP": "mbtl.cmdps",
    "check_cmdp": "mbtl.cmdps",
    "get_cmdp": "mbtl.cmdps",
    "TransferMatrix": "mbtl.benchmark",
    "compare": "mbtl.benchmark",
    "load_curves": "mbtl.benchmark",
    "load_matrix": "mbtl.benchmark",
}

__all__ = [
    "CMDP",
    "Bounds",
    "Callback",
    "Categorical",
    "CheckFailed",
    "Context",
    "ContextMismatch",
    "ContextSpace",
    "Cost",
    "Evaluation",
    "Failures",
    "Integer",
    "InvalidInput",
    "Linear",
    "Log",
    "MbtlError",
    "MissingExtra",
    "Notice",
    "Objective",
    "Pick",
    "Portfolio",
    "RunResult",
    "SimulationFailed",
    "Steps",
    "Stopping",
    "StorageError",
    "Study",
    "StudyError",
    "StudyFinished",
    "StudyMismatch",
    "Training",
    "TrainingFailed",
    "TrainingPruned",
    "TransferMatrix",
    "UnknownName",
    "Unreachable",
    "UnsavedPolicies",
    "Workers",
    "__version__",
    "check_cmdp",
    "compare",
    "create_study",
    "delete_study",
    "get_cmdp",
    "list_studies",
    "load_curves",
    "load_matrix",
    "load_portfolio",
    "load_study",
    "plot",
    "selectors",
]


def _read_sb3(folder: Path) -> Any:
    from mbtl.training import load_sb3  # needs the `train` extra

    return load_sb3(folder)


READERS["sb3"] = _read_sb3


def __getattr__(name: str) -> Any:
    if name == "plot":
        return importlib.import_module("mbtl.plot")
    if name in _LAZY:
        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'mbtl' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
