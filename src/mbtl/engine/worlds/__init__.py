"""Simulations of many contexts at once in jax; importing this starts jax (see `flags`).

`world.py` says what a world is, `hosted.py` makes one of a native simulator. `beats.py` lives
through whole episodes, `copies.py` steps simulations that start again one by one.
"""

from __future__ import annotations

from mbtl.engine.worlds import flags as flags  # isort: skip  # first: it starts jax
from mbtl.engine.worlds.environments import Box, Discrete, Environment, Step
from mbtl.engine.worlds.hosted import hosted
from mbtl.engine.worlds.world import Solo, World, context_of, stack_params

__all__ = [
    "Box",
    "Discrete",
    "Environment",
    "Solo",
    "Step",
    "World",
    "context_of",
    "hosted",
    "stack_params",
]
