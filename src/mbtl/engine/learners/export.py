"""Trained policies as plain numpy: members of a portfolio that need no jax to act."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.engine.learners.episodic.episodes import import_actor
from mbtl.engine.learners.networks import Weights
from mbtl.engine.learners.recipes import Activation
from mbtl.engine.worlds.environments import Box, Discrete, Law
from mbtl.engine.worlds.world import World
from mbtl.errors import InvalidInput
from mbtl.portfolio import BoxHead, DiscreteHead, MLPPolicy


def export_policies(
    world: World, weights: Weights, activation: Activation = "tanh"
) -> list[MLPPolicy]:
    """The acting part of P policies, leading axis; actions as in jax up to float32 rounding.

    Those of a lesson become policies of the world that the lesson is about.
    """
    weights = jax.tree.map(np.asarray, weights)  # one transfer, not one per policy
    each = [jax.tree.map(lambda x, p=p: x[p], weights) for p in range(len(weights.log_std))]
    law: Law | None = getattr(world, "law", None)
    if law is None:
        return [_policy(world.action, one, activation) for one in each]
    return [_policy(law.box, lawful(one, law, activation), activation) for one in each]


def lawful(weights: Weights, law: Law, activation: Activation) -> Weights:
    """One policy whose outputs are those of `law`: one unit per layer carries obs[feature] on.

    Through tanh it passes so small that it stays what it is, to a part in 10^7 while |obs| <= 1.

    Raises:
        InvalidInput: the activation bends what is small, too.
    """
    small = {"tanh": 1e-3, "relu": 1.0}.get(activation)
    if small is None:
        raise InvalidInput(f"other actions need layers of tanh or relu, got {activation!r}")
    layers = list(weights.actor)
    for k, (matrix, bias) in enumerate(layers[:-1]):
        column = np.zeros((len(matrix) + (k > 0), 1), np.float32)
        column[law.feature if k == 0 else -1] = small if k == 0 else 1.0
        wide = np.pad(matrix, ((0, int(k > 0)), (0, 0)))
        layers[k] = (np.concatenate([wide, column], axis=1), np.append(bias, np.float32(0.0)))
    matrix, bias = layers[-1]
    carried = np.full((1, matrix.shape[1]), law.gain / small, np.float32)
    scale = np.float32(law.scale)
    layers[-1] = (np.concatenate([scale * matrix, carried]), scale * bias)
    log_std = weights.log_std + np.log(scale)
    return weights._replace(actor=tuple(layers), log_std=log_std)


def taught(world: World, policy: Any, activation: Activation) -> Weights:
    """The weights of one exported policy, (1, ...), as a training in this world has them.

    There is no critic, (). Undoes `export_policies`, in a lesson up to float32 rounding.

    Raises:
        InvalidInput: it is none, or has another activation between its layers.
    """
    kind = getattr(policy, "activation", type(policy).__name__)
    if kind != activation:
        raise InvalidInput(
            f"a training begins from a policy of this engine with the activation {activation}, "
            f"got {kind}; train one with this trainer"
        )
    actor = import_actor([policy])
    network, log_std = actor.network, actor.log_std
    if (law := getattr(world, "law", None)) is not None:
        scale, last = np.float32(law.scale), len(network) - 1
        network = tuple(
            (w[:, :, :-1], b[:, :-1]) if k < last else (w / scale, b / scale)
            for k, (w, b) in enumerate(network)
        )
        network = (network[0], *((w[:, :-1], b) for w, b in network[1:]))
        log_std = log_std - jnp.log(scale)
    return Weights(network, (), log_std)


def _policy(action: Discrete | Box, weights: Weights, activation: Activation) -> MLPPolicy:
    head: DiscreteHead | BoxHead
    if isinstance(action, Discrete):
        head = DiscreteHead((action.n,))
    else:
        low, high = (np.array(bound, dtype=np.float32) for bound in (action.low, action.high))
        head = BoxHead(low, high, log_std=np.asarray(weights.log_std))
    layers = tuple(np.ascontiguousarray(w.T) for w, _ in weights.actor)
    biases = tuple(np.array(b) for _, b in weights.actor)
    return MLPPolicy(layers, biases, activation, (layers[0].shape[1],), head)
