"""Whole episodes of many simulations, of which those that have ended make room.

Simulations are played a part of an episode at a time, in blocks of one size, hence by one compiled
program. Between two parts those that go on move together, if that saves a block. Who is played with
whom decides nothing, so every episode is the same as without.

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

_SHARE, _BLOCKS, _LANES = 3, 8, 16
"""A block has a third of the episodes that it may have, or an eighth of all if that is more; a
multiple of what a processor computes at once, so that no place in it is computed otherwise."""


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


def size(count: int, most: int) -> int:
    """Of the blocks for `count` episodes of each policy, where `most` may be in one."""
    wanted = max(most // _SHARE, -(-count // _BLOCKS))
    return min(count, most, -(-wanted // _LANES) * _LANES)


def scores(
    episodes: Episodes, most: int, on_part: Callable[[int], None] = lambda ended: None
) -> Array:
    """(H, N) scores; `on_part` is told how many of the H x N episodes have ended, now and then."""
    found = np.empty((episodes.policies, episodes.each))
    width = size(episodes.each, most)
    numbers = np.arange(-(-episodes.each // width) * width)
    numbers[episodes.each :] = -1  # nobody's
    each = _cut(np.tile(numbers, (episodes.policies, 1)), width)
    blocks = [(one, episodes.start(np.maximum(one, 0))) for one in each]
    for now in range(0, episodes.length, episodes.part):
        if not blocks:
            break
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
        blocks = _closed_up(blocks, alive, width)
    return found


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

    def parted(*leaves: jax.Array) -> list[NDArray[Any]]:  # (H x W, ...) each
        wide = [np.asarray(x).reshape(len(alive), -1, *x.shape[1:]) for x in leaves]
        return [x.reshape(-1, *x.shape[2:]) for x in chosen(np.concatenate(wide, axis=1))]

    each = np.where(alive, np.concatenate([own for own, _ in blocks], axis=1), -1)
    flat = [jax.tree.flatten(state) for _, state in blocks]
    leaves = [parted(*some) for some in zip(*(leaves for leaves, _ in flat), strict=True)]
    states = [jax.tree.unflatten(flat[0][1], some) for some in zip(*leaves, strict=True)]
    return list(zip(chosen(each), states, strict=True))
