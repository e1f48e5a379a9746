"""Whole episodes of many simulations, of which those that have ended make room.

Simulations are played a part of an episode at a time, in blocks of few sizes, each of which is one
compiled program. Between two parts what has ended leaves, and what goes on moves together if that
saves a block. Who is played with whom decides nothing, so every episode is the same as without.

Notation (shapes): H policies, N episodes of each, W of them in a block; simulations of a block are
ordered policy by policy, (H x W, ...).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.worlds.environments import Tree

_FEWER = 4
"""A small block is as many times smaller than a large one."""


class Episodes(NamedTuple):
    """What is played.

    Attributes:
        policies: H.
        each: N.
        length: decisions of an episode at most.
        part: of them between two looks at what has ended.
        start: (H, W) numbers of episodes -> their first states.
        go_on: states, (H, W) numbers, first decision, and the one to stop at -> states then.
        seen: states -> (H x W,) scores so far, and which of them have ended.
    """

    policies: int
    each: int
    length: int
    part: int
    start: Callable[[NDArray[Any]], Tree]
    go_on: Callable[[Tree, NDArray[Any], int, int], Tree]
    seen: Callable[[Tree], tuple[Any, Any]]


def widths(count: int, most: int) -> list[int]:
    """Of the blocks for `count` episodes of each policy, at most `most` in a block."""
    few = -(-most // _FEWER)
    large, left = divmod(count, most)
    small = -(-left // few)
    if small * few >= most:
        large, small = large + 1, 0
    return [most] * large + [few] * small


def scores(
    episodes: Episodes, most: int, on_part: Callable[[int], None] = lambda ended: None
) -> Array:
    """(H, N) scores; `on_part` is told how many of the H x N episodes have ended, now and then."""
    found = np.empty((episodes.policies, episodes.each))
    sizes = widths(episodes.each, most)
    numbers = np.arange(sum(sizes))
    numbers[episodes.each :] = -1  # nobody's
    each = _cut(np.tile(numbers, (episodes.policies, 1)), sizes)
    blocks = [(one, episodes.start(np.maximum(one, 0))) for one in each]
    for now in range(0, episodes.length, episodes.part):
        stop, going = min(now + episodes.part, episodes.length), []
        for i, (own, state) in enumerate(blocks):
            state = episodes.go_on(state, np.maximum(own, 0), now, stop)
            blocks[i] = own, state
            score, over = (np.asarray(x).reshape(own.shape) for x in episodes.seen(state))
            policy, place = np.nonzero(own >= 0)
            found[policy, own[policy, place]] = score[policy, place]
            going.append((own >= 0) & ~over)
        alive = np.concatenate(going, axis=1)
        on_part(found.size - (int(alive.sum()) if stop < episodes.length else 0))
        blocks = _closed_up(blocks, alive, most)
        if not blocks:
            break
    return found


def _cut(whole: Any, sizes: list[int]) -> list[Any]:
    """Along the second axis."""
    return np.split(whole, np.cumsum(sizes)[:-1], axis=1)


def _closed_up(
    blocks: list[tuple[NDArray[Any], Tree]], alive: NDArray[np.bool_], most: int
) -> list[tuple[NDArray[Any], Tree]]:
    """The blocks, or fewer and smaller ones for those that are alive, where that is enough."""
    sizes = widths(int(alive.sum(axis=1).max()), most)
    if not sizes or sum(sizes) >= alive.shape[1]:
        return blocks if sizes else []
    order = np.argsort(~alive, axis=1, kind="stable")[:, : sum(sizes)]

    def chosen(whole: NDArray[Any]) -> list[NDArray[Any]]:  # (H, all, ...) -> of each block
        at = order.reshape(*order.shape, *[1] * (whole.ndim - 2))
        return _cut(np.take_along_axis(whole, at, axis=1), sizes)

    def parted(*leaves: jax.Array) -> list[NDArray[Any]]:  # (H x W, ...) each
        wide = [np.asarray(x).reshape(len(alive), -1, *x.shape[1:]) for x in leaves]
        return [x.reshape(-1, *x.shape[2:]) for x in chosen(np.concatenate(wide, axis=1))]

    each = np.where(alive, np.concatenate([own for own, _ in blocks], axis=1), -1)
    flat = [jax.tree.flatten(state) for _, state in blocks]
    leaves = [parted(*some) for some in zip(*(leaves for leaves, _ in flat), strict=True)]
    states = [jax.tree.unflatten(flat[0][1], some) for some in zip(*leaves, strict=True)]
    return list(zip(chosen(each), states, strict=True))
