"""Whole episodes of many simulations, of which those that have ended make room.

Simulations are played a part of an episode at a time, in blocks of one size, hence by one compiled
program. Between two parts those that go on move together, if that saves a block. Who is played with
whom decides nothing, so every episode is the same as without.

Notation (shapes): H policies, N episodes of each, W of them in a block; simulations of a block are
ordered policy by policy, (H x W, ...).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.engine.worlds.environments import Tree
from mbtl.engine.worlds.world import Solo

_SHARE, _BLOCKS, _LANES = 3, 8, 16
"""A block has a third of the episodes that it may have, or an eighth of all if that is more; a
multiple of what a processor computes at once, so that no place in it is computed otherwise."""


PARTS = 20
"""Of an episode, between which those that have ended make room."""

Play = Callable[[Tree, NDArray[np.uint32], Tree, int, int], Tree]
"""States, their (H, W) seeds and their parameters, first decision, and the one to stop at -> states
then."""


def size(count: int, most: int) -> int:
    """Of the blocks for `count` episodes of each policy, where `most` may be in one."""
    wanted = max(most // _SHARE, -(-count // _BLOCKS))
    return min(count, most, -(-wanted // _LANES) * _LANES)


def scores(
    world: Solo,
    params: Tree,
    seeds: NDArray[np.uint32],
    drawn: NDArray[Any],
    policies: int,
    most: int,
    play: Play,
) -> Array:
    """(H, N) scores of H policies in the episodes of all C contexts, context by context.

    Args:
        world: the dynamics.
        params: of the contexts, leading axis.
        seeds: (C, E) of the episodes in each, N = C x E.
        drawn: (C, E, ...) `World.draws` of the seeds.
        policies: H.
        most: simulations of a policy at once.
        play: plays a part of the episodes.
    """
    where, (n_contexts, n_episodes) = jax.tree.map(np.asarray, params), seeds.shape
    each = n_contexts * n_episodes
    seeds, drawn = seeds.reshape(each), drawn.reshape(each, *drawn.shape[2:])
    length = world.decisions(params)
    part = -(-length // PARTS) if world.ends_early else length

    def contexts(own: NDArray[Any]) -> Tree:
        return jax.tree.map(lambda x: x[own.ravel() // n_episodes], where)

    found, width = np.empty((policies, each)), size(each, most)
    numbers = np.arange(-(-each // width) * width)
    numbers[each:] = -1  # nobody's
    blocks: list[tuple[NDArray[Any], Tree]] = []
    for own in _cut(np.tile(numbers, (policies, 1)), width):
        blocks.append((own, _start(world, drawn[own.ravel()], contexts(own))))
    for now in range(0, length, part):
        if not blocks:
            break
        stop, going = min(now + part, length), []
        for i, (own, state) in enumerate(blocks):
            state = play(state, seeds[own], contexts(own), now, stop)
            blocks[i] = own, state
            score, over = (np.asarray(x).reshape(own.shape) for x in _seen(world, state))
            policy, place = np.nonzero(own >= 0)
            found[policy, own[policy, place]] = score[policy, place]
            going.append((own >= 0) & ~over)
        alive = np.concatenate(going, axis=1)
        blocks = _closed_up(blocks, alive, width)
    return found


@partial(jax.jit, static_argnums=0)
def _start(world: Solo, drawn: jax.Array, params: Tree) -> Tree:
    return world.start(drawn, params)


@partial(jax.jit, static_argnums=0)
def _seen(world: Solo, state: Tree) -> tuple[jax.Array, jax.Array]:
    return world.score(state), world.over(state)


def _cut(whole: Any, width: int) -> list[Any]:
    """Along the second axis."""
    return np.split(whole, whole.shape[1] // width, axis=1)


def _closed_up(
    blocks: list[tuple[NDArray[Any], Tree]], alive: NDArray[np.bool_], width: int
) -> list[tuple[NDArray[Any], Tree]]:
    """The blocks, or fewer of them where that is enough for those that are alive."""
    enough = -(-int(alive.sum(axis=1).max()) // width)
    if enough in (0, len(blocks)):
        return blocks[:enough]
    order = np.argsort(~alive, axis=1, kind="stable")[:, : enough * width]

    def chosen(whole: NDArray[Any]) -> list[NDArray[Any]]:  # (H, all, ...) -> of each block
        at = order.reshape(*order.shape, *[1] * (whole.ndim - 2))
        return _cut(np.take_along_axis(whole, at, axis=1), width)

    def parted(*leaves: jax.Array) -> list[NDArray[Any]]:  # (H x W, ...) each, or empty
        wide = [np.asarray(x).reshape(len(alive), width, *x.shape[1:]) for x in leaves]
        every = chosen(np.concatenate(wide, axis=1))
        return [x.reshape(len(alive) * width, *x.shape[2:]) for x in every]

    each = np.where(alive, np.concatenate([own for own, _ in blocks], axis=1), -1)
    flat = [jax.tree.flatten(state) for _, state in blocks]
    leaves = [parted(*some) for some in zip(*(leaves for leaves, _ in flat), strict=True)]
    states = [jax.tree.unflatten(flat[0][1], some) for some in zip(*leaves, strict=True)]
    return list(zip(chosen(each), states, strict=True))
