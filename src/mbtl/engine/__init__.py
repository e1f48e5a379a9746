"""Training thousands of contexts at once in jax: an extra, for worlds of your own as for ours.

    worlds         what a world is, and what steps, ends and records one
    learners       PPO, A2C, DQN, TRPO, PaCo and MOORE over many contexts and seeds
    world_trainer  both as a trainer of a study

jax is started by `worlds` and `learners`, and not before one of their names is asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mbtl.engine.simulators import SceneProblem
    from mbtl.engine.world_trainer import WorldTrainer
    from mbtl.engine.worlds import (
        Box,
        Discrete,
        Environment,
        Solo,
        Step,
        World,
        context_of,
        hosted,
        stack_params,
    )

__all__ = [
    "Box",
    "Discrete",
    "Environment",
    "SceneProblem",
    "Solo",
    "Step",
    "World",
    "WorldTrainer",
    "context_of",
    "hosted",
    "stack_params",
]

_HOMES = {"SceneProblem": "mbtl.engine.simulators", "WorldTrainer": "mbtl.engine.world_trainer"}


def __getattr__(name: str) -> Any:
    """Import a public name on first use (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES.get(name, "mbtl.engine.worlds")), name)


def __dir__() -> list[str]:
    return sorted(__all__)
