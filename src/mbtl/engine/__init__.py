"""Training thousands of contexts at once in jax: an extra, for worlds of your own as for ours.

    worlds         what a world is, and what steps, ends and records one
    learners       PPO, A2C, DQN, TRPO, PaCo and MOORE over many contexts and seeds
    world_trainer  both as a trainer of a study
    traced         simulators in jax of others as problems

jax is started by `worlds`, `learners` and `traced`, and not before one of their names is asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mbtl.engine.simulators import SceneProblem
    from mbtl.engine.traced import jax_problem
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
    "jax_problem",
    "stack_params",
]

_HOMES = {"SceneProblem": "simulators", "WorldTrainer": "world_trainer", "jax_problem": "traced"}


def __getattr__(name: str) -> Any:
    """Import a public name on first use (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES.get(name, 'worlds')}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
