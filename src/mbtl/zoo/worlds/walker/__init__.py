"""BipedalWalker in jax, a twin of Box2D's: ground, body, contacts and impulses."""

from mbtl.zoo.worlds.walker.walker import BipedalWalker, WalkerParams, WalkerState

__all__ = ["BipedalWalker", "WalkerParams", "WalkerState"]
