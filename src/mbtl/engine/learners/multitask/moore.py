"""MOORE: one policy on a mixture of orthogonal representations, weighted per context.

Hendawy, Peters, D'Eramo: "Multi-Task Reinforcement Learning with Mixture of Orthogonal Experts",
ICLR 2024. In state s and context c

    H(s) = [h_1(s), ..., h_K(s)]      K expert networks
    U(s) = Gram-Schmidt of H(s)       orthonormal, so no two experts say the same
    v    = activation(sum_k w_ck u_k(s))
    f    = head of v                  logits or mean, and for the critic the value

with task weights w_c. Actor and critic have experts, task weights and head each of their own.

What differs from the paper: experts are dense networks, and see the visible features, in place of
a one-hot code of the task at the head; task weights are interpolated between contexts (`table.py`)
and begin as hat functions of the axis.

Notation (shapes): N contexts, K experts, n units of a representation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.engine.learners import networks
from mbtl.engine.learners.multitask.table import initial_table, rows_at
from mbtl.engine.learners.networks import Network
from mbtl.engine.learners.recipes import Activation, MultiTaskRecipe
from mbtl.engine.worlds.world import Solo

_TINY = 1e-12  # under the root of a squared length: the gradient of a zero vector is finite


class Mixture(NamedTuple):
    """A network of experts; the place is the last number of an observation.

    Attributes:
        experts: layers (K, n_in, n_out) and (K, n_out), an activation between them.
        task_weights: (N, K).
        head: (n, n_outputs) and (n_outputs,).
    """

    experts: Network
    task_weights: jax.Array
    head: tuple[jax.Array, jax.Array]

    def __call__(self, observations: jax.Array, activation: Activation) -> jax.Array:
        """(..., o + 1) -> (..., n_outputs)."""
        bend = networks.BENDS[activation]
        seen, place = observations[..., :-1], observations[..., -1]
        weights = rows_at(self.task_weights, place)
        # an expert at a time: one batched product over all of them is slower on a CPU
        parts = range(weights.shape[-1])
        experts = (jax.tree.map(lambda x, k=k: x[k], self.experts) for k in parts)
        each = [networks.apply(expert, seen, activation) for expert in experts]
        basis = orthonormal(each)
        v = bend(sum(weights[..., k, None] * u for k, u in enumerate(basis)))
        weight, bias = self.head
        return v @ weight + bias


class MOOREWeights(NamedTuple):
    """Everything that is learned, as in `networks.Weights`; `log_std` is the same everywhere."""

    actor: Mixture
    critic: Mixture
    log_std: jax.Array


def orthonormal(vectors: Sequence[jax.Array]) -> list[jax.Array]:
    """Gram-Schmidt: K orthonormal vectors (..., n) that span what the first 1, 2, ..., K do.

    A sum over the last axis is written as a product with ones, which a CPU does many times faster.
    """
    ones = jnp.ones((vectors[0].shape[-1], 1))
    basis: list[jax.Array] = []
    for vector in vectors:
        rest = vector
        for unit in basis:
            rest = rest - ((rest * unit) @ ones) * unit
        basis.append(rest * jax.lax.rsqrt((rest * rest) @ ones + _TINY))
    return basis


def init_weights(
    world: Solo, recipe: MultiTaskRecipe, seed: int, n_contexts: int, n_inputs: int
) -> MOOREWeights:
    """Orthogonal layers, gains as in `networks.init_weights`; hats as task weights."""
    rng = np.random.default_rng(seed)
    hidden, n_parts = recipe.hidden, recipe.n_parts

    def layer(n_in: int, n_out: int) -> Any:
        each = [networks.orthogonal(rng, n_in, n_out, math.sqrt(2.0)) for _ in range(n_parts)]
        return np.stack(each), np.zeros((n_parts, n_out), dtype=np.float32)

    def mixture(n_outputs: int, gain: float) -> Mixture:
        experts = tuple(layer(*pair) for pair in itertools.pairwise([n_inputs, *hidden]))
        head: Any = networks.orthogonal(rng, hidden[-1], n_outputs, gain)
        table: Any = initial_table(n_contexts, n_parts)
        return Mixture(experts, table, (head, np.zeros(n_outputs, dtype=np.float32)))

    plain = networks.init_weights(seed, 1, world.action, (), recipe.log_std)
    return MOOREWeights(
        mixture(networks.n_outputs(world.action), 0.01), mixture(1, 1.0), plain.log_std
    )
