"""Worlds that know rules by which their agents may act: what a training can begin with."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@runtime_checkable
class Rules(Protocol):
    """A world that knows rules by which its agents may act, as networks of tanh."""

    def rule(self, name: str) -> tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]:
        """Layers (weight (n_in, n_out), bias (n_out,)) for observations without visible context.

        Raises:
            UnknownName: there is no such rule.
            InvalidInput: it is one for other actions than this world's.
        """
        ...
