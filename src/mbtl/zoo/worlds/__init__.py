"""Our simulators in jax, for batches of contexts; importing this starts jax."""

from mbtl.engine.worlds import flags as flags  # isort: skip  # first: it starts jax
from mbtl.zoo.worlds.cartpole import CartPole
from mbtl.zoo.worlds.pendulum import Pendulum

__all__ = ["CartPole", "Pendulum"]
