"""Worlds of traffic; see `mbtl.training.jax.world`."""

from mbtl.training.jax.world import Moved, Seeded, Seen
from mbtl.training.jax.world import World as Twin

__all__ = ["Moved", "Seeded", "Seen", "Twin"]
