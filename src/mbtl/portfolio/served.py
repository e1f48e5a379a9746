"""How well a portfolio serves contexts that it was not chosen by: held out, between, or one target.

Notation (shapes): n contexts, E episodes of each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context, ContextSpace
from mbtl.episodes import margin_of_sum
from mbtl.objective import Bounds
from mbtl.portfolio.router import Choice
from mbtl.routing import SURE


@dataclass(frozen=True, eq=False, repr=False)
class Served:
    """What the policies that serve some contexts returned there, on fresh episodes.

    Attributes:
        space: of the portfolio.
        contexts: n of them.
        choices: who served each, and what was expected of it.
        returns: (n, E) raw units.
        bounds: normalisation.
        drawn: the contexts are a random sample of the axes.
        lost: how many more were played, and gave no episode that counts.
    """

    space: ContextSpace
    contexts: tuple[Context, ...]
    choices: tuple[Choice, ...]
    returns: Array
    bounds: Bounds
    drawn: bool
    lost: int = 0

    @property
    def performances(self) -> Array:
        """(n,) mean normalised returns."""
        return self.bounds.normalise(self.returns.mean(axis=1))

    @property
    def value(self) -> float:
        """V on these contexts."""
        return float(self.performances.mean())

    @property
    def margin(self) -> float:
        """Half a 95 % interval of V; of given contexts nothing but the luck of the episodes."""
        if self.drawn:
            spread = float(self.performances.std(ddof=1)) if len(self.contexts) > 1 else math.inf
            return SURE * spread / math.sqrt(len(self.contexts))
        return margin_of_sum(self.bounds.normalise(self.returns) / len(self.contexts))

    @property
    def expected(self) -> Array:
        """(n,) performance that the router expected."""
        return self.bounds.normalise(np.array([one.predicted_return for one in self.choices]))

    @property
    def off(self) -> float:
        """Root of the mean square of what was expected less what came: how well it interpolates."""
        return float(np.sqrt(np.square(self.expected - self.performances).mean()))

    @property
    def worst(self) -> Context:
        """The context that is served worst."""
        return self.contexts[int(self.performances.argmin())]

    def __repr__(self) -> str:
        worst = self.space.describe(self.worst)
        lost = f"; {self.lost} more gave no episode" if self.lost else ""
        return (
            f"Served({len(self.contexts)} contexts: V = {self.value:.4f} +- {self.margin:.4f}, "
            f"expected {self.expected.mean():.4f}, off by {self.off:.4f}; worst at {worst}, "
            f"{self.performances.min():.4f}{lost})"
        )
