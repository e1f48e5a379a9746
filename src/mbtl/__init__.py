"""mbtl: choose which tasks to train on.

Model-based transfer learning for contextual reinforcement learning: train K of N contexts, chosen
one after another, and serve every context with the best of the trained policies.
"""

from __future__ import annotations

import pkgutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbtl import selectors, strategies
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
from mbtl.provider import laboratory
from mbtl.score import Score
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
from mbtl.version import __version__

if TYPE_CHECKING:  # what `__getattr__` finds when it is asked for
    from mbtl import plot
    from mbtl.problems import CMDP, check_cmdp, get_cmdp
    from mbtl.zoo.benchmark import TransferMatrix, compare, load_matrix, load_transfers

_LATER = {
    "plot": "mbtl.plot:",
    "CMDP": "mbtl.problems:CMDP",
    "check_cmdp": "mbtl.problems:check_cmdp",
    "get_cmdp": "mbtl.problems:get_cmdp",
}
"""Imported when first used, so that `import mbtl` stays light."""

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
    "Integer",
    "InvalidInput",
    "Linear",
    "Log",
    "MbtlError",
    "Objective",
    "Pick",
    "Portfolio",
    "Score",
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
    "get_cmdp",
    "load_matrix",
    "load_portfolio",
    "load_study",
    "load_transfers",
    "plot",
    "selectors",
    "strategies",
]


def _read_sb3(folder: Path) -> Any:
    from mbtl.trainers import load_sb3  # needs the `train` extra

    return load_sb3(folder)


READERS["sb3"] = _read_sb3


def __getattr__(name: str) -> Any:
    if name in __all__ and (home := _LATER.get(name) or laboratory().names.get(name)):
        return pkgutil.resolve_name(home)
    raise AttributeError(f"module 'mbtl' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
