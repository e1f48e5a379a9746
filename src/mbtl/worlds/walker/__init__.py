"""BipedalWalker in jax, a twin of Box2D's: ground, body, contacts, impulses, and the environment.

`walker.py` has the step, the others what it needs: `ground.py` the line walked on, `body.py` masses
and joints, `contact.py` where legs touch the ground, `impulses.py` what forces do within a step,
`impact.py` what comes down within it.
"""

from mbtl.worlds.walker.walker import BipedalWalker, WalkerParams, WalkerState

__all__ = ["BipedalWalker", "WalkerParams", "WalkerState"]
