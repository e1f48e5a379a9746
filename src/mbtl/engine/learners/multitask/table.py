"""One learned vector per context, linear between neighbours.

PaCo and MOORE know a finite set of tasks, here the N contexts of the grid. A place p is a position
on the context axis in grid steps, 0 <= p <= N - 1: a whole number is a context that was trained on,
and a context between two of them gets a mixture of their vectors. That is how both methods are
carried over to a continuous axis.

Networks with such a table find the place as the last number of an observation: `loop.in_sets` makes
it one more visible feature, so that environments, rollouts and evaluations need not know of it.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray


def rows_at(table: jax.Array, place: jax.Array) -> jax.Array:
    """(..., K) vectors of `table` (N, K) at `place` (...).

    A product with hat functions, which are one-hot on the grid: on a CPU a gather would be slow,
    and its gradient, a scatter, slower.
    """
    hats = jnp.maximum(0.0, 1.0 - jnp.abs(place[..., None] - jnp.arange(len(table))))
    return hats @ table


def initial_table(n_contexts: int, n_parts: int) -> NDArray[np.float32]:
    """(N, K) hat functions on K knots spread evenly over the axis: rows sum to 1.

    Contexts begin with the part of the nearest knots, so neighbours begin alike.
    """
    knots = np.linspace(0.0, 1.0, n_parts)
    position = np.linspace(0.0, 1.0, n_contexts)[:, None]
    hats = np.maximum(0.0, 1.0 - np.abs(position - knots) * (n_parts - 1))
    return hats.astype(np.float32)
