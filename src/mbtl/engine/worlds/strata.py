"""Luck of a few known kinds: an evaluated episode is one of each kind, and worth their mean.

A world that knows such kinds says so: `strata(params)` gives the parameters of C contexts with each
of K kinds, context by context, (C x K, ...), and how probable the kinds are, (C, K).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.arrays import Array


def of_each_kind(world: Any, params: Any) -> tuple[Any, Array]:
    """What a world says; the parameters themselves and shares of 1 where it says nothing."""
    if hasattr(world, "strata"):
        every, shares = world.strata(params)
        return every, shares
    return params, np.ones((len(params.visible), 1))


def merged(scores: Array, shares: Array) -> Array:
    """(P, C, E) from (P, C x K, E): the mean of the kinds, weighted by how probable they are."""
    each = scores.reshape(len(scores), *shares.shape, scores.shape[-1])
    mean: Array = np.einsum("pcke,ck->pce", each, shares)
    return mean
