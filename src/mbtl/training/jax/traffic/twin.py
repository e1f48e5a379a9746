"""Worlds of traffic; see `mbtl.training.jax.world`."""

from mbtl.training.jax.world import Crowd, Moved, Seeded, Seen, everyone
from mbtl.training.jax.world import World as Twin

__all__ = ["Crowd", "Moved", "Seeded", "Seen", "Twin", "everyone"]
