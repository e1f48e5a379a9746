"""Simulations in the last axis: the same as one alone, however they are vectorised."""

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.engine.worlds.vectorised import batch_last


def _turned(state, speed):
    """Of (2, n) places, turned by (n,) angles; and how many walkers there are together."""
    place, counts = state
    x, y = place
    sin, cos = jnp.sin(speed), jnp.cos(speed)
    moved = jnp.stack([cos * x - sin * y, sin * x + cos * y])
    return moved, jnp.full(counts.shape, place.shape[-1])


def test_a_function_of_many_serves_one_and_any_nesting_together():
    turn, rng = batch_last(_turned), np.random.default_rng(0)
    places, speed = rng.random((2, 3, 2)), rng.random((2, 3))
    flat, together = jax.vmap(turn)((places[0], np.zeros(3, int)), speed[0])
    np.testing.assert_array_equal(together, [3, 3, 3])
    every = jax.vmap(jax.vmap(turn))
    nested, together = jax.jit(every)((places, np.zeros((2, 3), int)), speed)
    np.testing.assert_array_equal(together, np.full((2, 3), 6))
    np.testing.assert_allclose(nested[0], flat, atol=1e-6)
    alone, together = turn((places[1, 2], np.int32(0)), speed[1, 2])
    assert int(together) == 1
    np.testing.assert_allclose(nested[1, 2], alone, atol=1e-6)


def test_an_argument_that_all_share_is_shared():
    turn, places = batch_last(_turned), np.random.default_rng(0).random((4, 2))
    shared, _ = jax.vmap(turn, (0, None))((places, np.zeros(4, int)), 0.5)
    each, _ = jax.vmap(turn)((places, np.zeros(4, int)), np.full(4, 0.5))
    np.testing.assert_array_equal(shared, each)
