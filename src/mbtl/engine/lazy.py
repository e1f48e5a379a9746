"""`mbtl.engine.learners` for those who must not start jax: imported on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mbtl.engine.learners import *  # noqa: F403


def __getattr__(name: str) -> Any:
    import mbtl.engine.learners

    return getattr(mbtl.engine.learners, name)
