"""Simulations in the last axis: the same as one alone, however they are vectorised."""

from typing import NamedTuple

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")

import mbtl.engine.worlds  # noqa: F401  sets jax's flags

import jax  # isort: skip
import jax.numpy as jnp  # isort: skip

from mbtl.engine.worlds import ends
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


class _Params(NamedTuple):
    lasts: np.ndarray
    visible: np.ndarray


class _Walks:
    """A state is how long the episode lasts, and its decisions so far."""

    ends_early = True

    def draws(self, seeds):
        return 2.0 * seeds[:, None]

    def decisions(self, params):
        return 40

    def start(self, drawn, params):
        return jnp.stack([params.lasts + drawn[:, 0], 0.0 * params.lasts], axis=1)

    def score(self, state):
        return state[:, 1]

    def over(self, state):
        return state[:, 1] >= state[:, 0]


@pytest.mark.parametrize(("policies", "contexts", "most"), [(3, 16, 48), (2, 2, 48)])
def test_episodes_that_end_make_room_and_keep_their_scores(policies, contexts, most):
    rng = np.random.default_rng(0)
    own, seeds = rng.integers(1, 30, contexts), rng.integers(0, 4, (contexts, 4), np.uint32)
    lasts, played = own[:, None] + 2.0 * seeds, []

    def play(state, seeds, params, first, stop):
        on = np.asarray(state[:, 0]) > first
        np.testing.assert_array_equal(state[on, 0], (params.lasts + 2.0 * seeds.ravel())[on])
        played.append(len(on) * (stop - first))
        return jnp.asarray(state).at[:, 1].set(jnp.minimum(state[:, 0], stop))

    params = _Params(own, np.zeros((contexts, 0)))
    drawn = 2.0 * seeds[..., None]
    found = ends.scores(_Walks(), params, seeds, drawn, policies, most, play)
    np.testing.assert_array_equal(found, np.tile(lasts.ravel(), (policies, 1)))
    assert {n % (ends.size(lasts.size, most) * policies) for n in played} == {0}
    if lasts.size > most:
        assert sum(played) < 0.75 * 40 * found.size
