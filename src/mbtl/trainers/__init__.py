"""Trainers: the contract, and adapters of plain functions and of Stable-Baselines3.

What is heavy is imported on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mbtl.trainers.contract import (
    Ability,
    CountingTrainer,
    FunctionTrainer,
    ManyTrainer,
    MeasuringTrainer,
    OnProgress,
    Progress,
    RehearsingTrainer,
    Trained,
    Trainer,
    reference_rows,
)

if TYPE_CHECKING:
    from mbtl.trainers.export import export_mlp
    from mbtl.trainers.sb3 import SB3Trainer
    from mbtl.trainers.sb3_files import load_sb3

__all__ = [
    "Ability",
    "CountingTrainer",
    "FunctionTrainer",
    "ManyTrainer",
    "MeasuringTrainer",
    "OnProgress",
    "Progress",
    "RehearsingTrainer",
    "SB3Trainer",
    "Trained",
    "Trainer",
    "export_mlp",
    "load_sb3",
    "reference_rows",
]

_HOMES = {
    "SB3Trainer": "mbtl.trainers.sb3",
    "export_mlp": "mbtl.trainers.export",
    "load_sb3": "mbtl.trainers.sb3_files",
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
