"""Gap models: how performance decays from the context a policy was trained on.

Notation (shapes): k rows observed, N targets.
    theta     performance lost per grid step
    distance  (k, N)  Euclidean distance in grid steps, source to target
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.models.gp import squared_distances


class GapModel(Protocol):
    """Gives the slope of the linear gap after a history."""

    def slope(self, history: History, steps: Array) -> float:
        """Performance lost per grid step; `steps` is (N, D)."""
        ...


@dataclass(frozen=True)
class LinearGap:
    """J(pi_x, x) - J(pi_x, x') = theta |x - x'| with a given theta (paper, Assumption 1)."""

    theta: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.theta) and self.theta >= 0):
            raise InvalidInput(f"theta must be finite and >= 0, got {self.theta!r}")

    def slope(self, history: History, steps: Array) -> float:
        """The given theta, whatever was observed."""
        return self.theta


@dataclass(frozen=True)
class FittedGap:
    """The linear gap with theta fitted to the rows seen, by least squares through the origin.

    theta = sum d (J(pi_x, x) - J(pi_x, x')) / sum d^2 over all observed pairs, not below 0; before
    the first row, `prior`.
    """

    prior: float

    def slope(self, history: History, steps: Array) -> float:
        """Fitted theta; `prior` while no row has two evaluated targets."""
        if not len(history):
            return self.prior
        sources = np.asarray(history.sources, dtype=np.intp)
        distance = np.sqrt(squared_distances(steps[sources], steps))
        loss = history.training_performance[:, None] - history.rows
        seen = np.isfinite(loss)
        weight = float(np.square(distance[seen]).sum())
        return (
            max(float((distance[seen] * loss[seen]).sum()) / weight, 0.0) if weight else self.prior
        )


def predicted_rows(
    training_performance: Array, sources: Array, steps: Array, theta: float
) -> Array:
    """Rows that the linear gap predicts, J(pi_i, x_i) - theta |x_i - x'|.

    Args:
        training_performance: (k,) J(pi_i, x_i).
        sources: (k, D) grid steps of x_i.
        steps: (N, D) grid steps of the targets x'.
        theta: slope of the gap, performance per grid step.

    Returns:
        (k, N) predicted performance.
    """
    distance = np.sqrt(squared_distances(sources, steps))
    return np.asarray(training_performance[:, None] - theta * distance)
