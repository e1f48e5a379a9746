"""Trained policies as plain numpy: members of a portfolio that need no jax to act."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.portfolio import BoxHead, DiscreteHead, MLPPolicy
from mbtl.training.jax.networks import Network, Weights
from mbtl.training.jax.recipes import Activation
from mbtl.worlds.environments import Box, Discrete
from mbtl.worlds.world import World


def export_policies(
    world: World, weights: Weights, activation: Activation = "tanh"
) -> list[MLPPolicy]:
    """The acting part of P policies, leading axis; actions as in jax up to float32 rounding."""
    weights = jax.tree.map(np.asarray, weights)  # one transfer, not one per policy
    return [
        _policy(world, jax.tree.map(lambda x, p=p: x[p], weights), activation)
        for p in range(len(weights.log_std))
    ]


def import_actors(policies: list[MLPPolicy]) -> Network:
    """The actors of policies of one shape, stacked for `evaluate`."""
    layers = zip(*[zip(p.weights, p.biases, strict=True) for p in policies], strict=True)
    stacked = [[np.stack([w.T for w, _ in x]), np.stack([b for _, b in x])] for x in layers]
    return tuple((jnp.asarray(w), jnp.asarray(b)) for w, b in stacked)


def _policy(world: World, weights: Weights, activation: Activation) -> MLPPolicy:
    n_inputs = weights.actor[0][0].shape[0]
    return MLPPolicy(
        weights=tuple(np.ascontiguousarray(w.T) for w, _ in weights.actor),
        biases=tuple(np.array(b) for _, b in weights.actor),
        activation=activation,
        observation_shape=(n_inputs,),
        head=_head(world.action, np.asarray(weights.log_std)),
    )


def _head(action: Discrete | Box, log_std: np.ndarray) -> DiscreteHead | BoxHead:
    if isinstance(action, Discrete):
        return DiscreteHead((action.n,))
    low, high = (np.array(bound, dtype=np.float32) for bound in (action.low, action.high))
    return BoxHead(low, high, log_std=log_std)
