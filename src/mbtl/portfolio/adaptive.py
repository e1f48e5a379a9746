"""Serving a context that is not told: which policy to play next, from the returns so far.

A posterior over the listed contexts, from what each policy that was played returned:

    p(x | r_1:t)  ~  w(x) prod_i [(1 - e) N(r_i; J(k_i, x), s(k_i, x)^2) + e / range]

The next episode is played by the policy k that is best, and for as many episodes as follow, T,
counts what its return would teach:

    E[J(k, x)] + T (E_r max_j E[J(j, x) | r] - max_j E[J(j, x)])

The second part is the knowledge gradient (Frazier, Powell and Dayanik, 2008), by quadrature.

Notation (shapes): k policies, N listed contexts; all in performance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mbtl.acquisition import argmax_open
from mbtl.arrays import Array
from mbtl.contexts import Context, ContextSpace
from mbtl.errors import InvalidInput
from mbtl.objective import Bounds

_ODD = 0.01
"""Chance that a return has nothing to do with what is believed of it: e."""
_BLUR = 0.03
"""Deviation of a context from the listed ones, as a share of the range of performance."""
_PRIOR = 4.0
"""Episodes that the mean deviation of a policy counts as, beside those of one context."""
_LIKELY = 1e-4
"""Contexts less likely than that, relative to the likeliest, teach nothing."""
_AHEAD = 3
"""Episodes for which what a return teaches counts at most: later ones teach it, too."""
_NODES = np.array([-np.sqrt(3.0), 0.0, np.sqrt(3.0)])
_WEIGHTS = np.array([1.0, 4.0, 1.0]) / 6.0
"""Gauss-Hermite quadrature of a normal return."""


@dataclass
class Adaptive:
    """Chooses a policy for each episode in a context that nobody tells.

    `serving = portfolio.adaptive()`, and for each episode
    `serving.observe(play(serving.policy))` with its return.

    Attributes:
        space: the listed contexts.
        bounds: normalisation of the returns.
        mean: (k, N) what each policy is believed to return where, performance.
        own: (k, N) deviations of single episodes (`deviations`).
        load: position -> policy.
        episodes: how many are expected in this context; the more, the more is tried out.
        forget: chance per episode that the context has changed.
        chances: (N,) of the listed contexts.
        played: policies and raw returns so far.
    """

    space: ContextSpace = field(repr=False)
    bounds: Bounds = field(repr=False)
    mean: Array = field(repr=False)
    own: Array = field(repr=False)
    load: Callable[[int], Any] = field(repr=False)
    episodes: int = 10
    forget: float = 0.0
    chances: Array = field(init=False, repr=False)
    played: list[tuple[int, float]] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        if self.episodes < 1 or not 0.0 <= self.forget <= 1.0:
            raise InvalidInput(
                "episodes must be 1 or more and forget a chance, in [0, 1], got "
                f"{self.episodes} and {self.forget}"
            )
        self.chances = self.space.weights.copy()
        self._range = max(float(np.ptp(self.mean)), 1e-9)
        self._deviation = np.hypot(self.own, _BLUR * self._range)

    # ---- what to play ------------------------------------------------------------------------

    @property
    def next(self) -> int:
        """Position of the policy to play in the next episode; the first of equals."""
        expected = self.mean @ self.chances
        left = min(self.episodes - len(self.played) - 1, _AHEAD)
        if left > 0 and len(expected) > 1:
            expected = expected + left * self._taught(float(expected.max()))
        return argmax_open(expected, np.ones(len(expected), dtype=bool))

    @property
    def policy(self) -> Any:
        """The policy to play in the next episode."""
        return self.load(self.next)

    @property
    def expected(self) -> Array:
        """(k,) expected raw return of each policy."""
        return self.bounds.denormalise(self.mean @ self.chances)

    @property
    def context(self) -> Context:
        """The likeliest listed context."""
        return self.space.context(int(self.chances.argmax()))

    # ---- what was seen -----------------------------------------------------------------------

    def observe(self, value: float, policy: int | None = None) -> None:
        """Learn from an episode.

        Args:
            value: its return, raw.
            policy: position of the policy that was played; `next` when missing.

        Raises:
            InvalidInput: the return is not finite, or there is no such policy.
        """
        which = self.next if policy is None else policy
        if np.ndim(value) or not np.isfinite(value) or not 0 <= which < len(self.mean):
            raise InvalidInput(
                f"an episode has a finite return and a policy of 0 to {len(self.mean) - 1}, "
                f"got {value!r} of policy {which}"
            )
        seen = self.bounds.normalise(np.array([float(value)]))
        told = self.chances * self._likelihood(which, seen)[0]
        self.chances = told / told.sum()
        self.played.append((which, float(value)))
        if self.forget:
            prior = self.space.weights
            self.chances = (1.0 - self.forget) * self.chances + self.forget * prior

    # ---- inside ------------------------------------------------------------------------------

    def _likelihood(self, policy: int, seen: Array) -> Array:
        """(R, N) of performances `seen`, (R,)."""
        deviation = self._deviation[policy]
        off = (seen[:, None] - self.mean[policy]) / deviation
        normal = np.exp(-0.5 * off**2) / (np.sqrt(2.0 * np.pi) * deviation)
        return np.asarray((1.0 - _ODD) * normal + _ODD / self._range)

    def _taught(self, best: float) -> Array:
        """(k,) by how much the best expected performance rises with the return of each policy."""
        likely = np.flatnonzero(self.chances > _LIKELY * self.chances.max())
        gain = np.empty(len(self.mean))
        for k, (mean, deviation) in enumerate(zip(self.mean, self._deviation, strict=True)):
            seen = (mean[likely] + _NODES[:, None] * deviation[likely]).ravel()
            chance = (self.chances[likely] * _WEIGHTS[:, None]).ravel()
            after = self._likelihood(k, seen) * self.chances
            after /= after.sum(axis=1, keepdims=True)
            gain[k] = chance @ (after @ self.mean.T).max(axis=1) / chance.sum() - best
        return np.maximum(gain, 0.0)


def deviations(episodes: Sequence[Array], shape: tuple[int, ...], width: float) -> Array:
    """(k, N) of single episodes, performance; each drawn to the mean one of its policy.

    Args:
        episodes: k arrays (N, E_i), raw returns, NaN where none was played.
        shape: (k, N), zeros of which are returned where there are no episodes.
        width: of the bounds.
    """
    if not len(episodes):
        return np.zeros(shape)
    found = np.empty(shape)
    for row, each in zip(found, episodes, strict=True):
        there = np.isfinite(each)
        free = np.maximum(there.sum(axis=1) - 1.0, 0.0)
        mean = np.where(there, each, 0.0).sum(axis=1) / np.maximum(there.sum(axis=1), 1)
        total = (np.where(there, each - mean[:, None], 0.0) ** 2).sum(axis=1)
        usual = total.sum() / max(free.sum(), 1.0)
        row[:] = np.sqrt((total + _PRIOR * usual) / (free + _PRIOR)) / width
    return found
