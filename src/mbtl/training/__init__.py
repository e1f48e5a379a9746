"""Training: adapters to RL libraries, outside the core; nothing heavy is imported before use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mbtl.training.export import export_mlp
    from mbtl.training.sb3 import SB3Trainer
    from mbtl.training.sb3_files import load_sb3
    from mbtl.training.world_trainer import WorldTrainer

__all__ = ["SB3Trainer", "WorldTrainer", "export_mlp", "load_sb3"]

_HOMES = {
    "SB3Trainer": "mbtl.training.sb3",
    "WorldTrainer": "mbtl.training.world_trainer",
    "export_mlp": "mbtl.training.export",
    "load_sb3": "mbtl.training.sb3_files",
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
