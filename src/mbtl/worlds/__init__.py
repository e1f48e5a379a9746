"""Physics in jax: simulations of many contexts at once; importing this starts jax (see `flags`).

`world.py` says what a world is, `hosted.py` makes one of a native simulator. `beats.py` lives
through whole episodes, `copies.py` steps simulations that start again one by one. Each family has
its files: `cartpole.py`, `pendulum.py`, and those of traffic.
"""

from __future__ import annotations

from mbtl.worlds import flags as flags  # isort: skip  # first: it starts jax
from mbtl.worlds.cartpole import CartPole
from mbtl.worlds.environments import Box, Discrete, Environment, Step
from mbtl.worlds.hosted import hosted
from mbtl.worlds.pendulum import Pendulum
from mbtl.worlds.world import Solo, World, context_of, stack_params

__all__ = [
    "Box",
    "CartPole",
    "Discrete",
    "Environment",
    "Pendulum",
    "Solo",
    "Step",
    "World",
    "context_of",
    "hosted",
    "stack_params",
]
