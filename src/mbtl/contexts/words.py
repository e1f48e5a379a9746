"""Contexts for people, where several are meant at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts.space import ContextSpace


def describe_set(space: ContextSpace, contexts: Sequence[int], between: str = ", ") -> str:
    """Contexts by index: "all contexts", "12 contexts", or one as `describe` has it."""
    if len(contexts) == 1:
        return space.describe(space.context(contexts[0]), between)
    return "all contexts" if len(contexts) == space.n else f"{len(contexts)} contexts"


def middle_of(contexts: Sequence[int], steps: Array) -> int:
    """The context of several, by index, that is nearest to their middle: where one is drawn."""
    if len(contexts) == 1:
        return int(contexts[0])
    places = steps[list(contexts)]
    middle = (places.min(axis=0) + places.max(axis=0)) / 2.0
    return int(contexts[int(np.linalg.norm(places - middle, axis=1).argmin())])
