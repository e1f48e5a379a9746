"""BipedalWalker in jax, a twin of Box2D's: ground, body, contacts, impulses, and the environment.

`walker.py` is the environment, `motion.py` a step of its world. That needs `ground.py`, the line
walked on, `body.py`, masses and joints, `contact.py`, where legs touch the ground, `impulses.py`,
what forces do within a step, and `impact.py`, what comes down within it.
"""

from mbtl.worlds.walker.motion import WalkerParams, WalkerState
from mbtl.worlds.walker.walker import BipedalWalker

__all__ = ["BipedalWalker", "WalkerParams", "WalkerState"]
