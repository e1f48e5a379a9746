"""The engine in jax for those who must not start it: `mbtl.training.jax`, imported on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mbtl.training.jax import *  # noqa: F403


def __getattr__(name: str) -> Any:
    import mbtl.training.jax

    return getattr(mbtl.training.jax, name)
