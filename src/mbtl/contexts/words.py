"""Contexts for people, where several are meant at once."""

from __future__ import annotations

from collections.abc import Sequence

from mbtl.contexts.space import ContextSpace


def describe_set(space: ContextSpace, contexts: Sequence[int]) -> str:
    """Contexts by index: "all contexts", "12 contexts", or one as `describe` has it."""
    if len(contexts) == 1:
        return space.describe(space.context(contexts[0]))
    return "all contexts" if len(contexts) == space.n else f"{len(contexts)} contexts"
