"""Serving a context that is not told: which policy to play next, from the returns so far.

A posterior over the listed contexts, from what each policy that was played returned:

    p(x | r_1:t)  ~  w(x) prod_i [(1 - e) N(r_i; J(k_i, x), s(k_i, x)^2) + e / range]

The next episode is played by the policy k that is best, and for as many episodes as follow, T,
counts what its return would teach:

    E[J(k, x)] + T (E_r max_j E[J(j, x) | r] - max_j E[J(j, x)])

The second part is the knowledge gradient (Frazier, Powell and Dayanik, 2008), by quadrature.

Where it is known what policies show in each part of an episode (`Signs`), a part counts in place of
the return, one such factor per entry of its vector, and the policy may change after it. Then the
policy of the largest expected return to go is played: looking around within an episode cost more
than it taught (`python benchmarks/hidden_within_episode.py`).

Notation (shapes): k policies, N listed contexts; all in performance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mbtl.acquisition import TIE, argmax_open
from mbtl.arrays import Array
from mbtl.contexts import Context, ContextSpace
from mbtl.errors import InvalidInput
from mbtl.objective import Bounds
from mbtl.portfolio.signs import Signs, Step, shown

_ODD = 0.01
"""Chance that a return has nothing to do with what is believed of it: e."""
_BLUR = 0.03
"""Deviation of a context from the listed ones, as a share of the range of performance."""
_PRIOR = 4.0
"""Episodes that the mean deviation of a policy counts as, beside those of one context."""
_LIKELY = 1e-4
"""Contexts less likely than that, relative to the likeliest, teach nothing."""
_NEVER = 1e-300
"""Chance of a context that parts have ruled out: later ones may bring it back."""
_AHEAD = 3
"""Episodes for which what a return teaches counts at most: later ones teach it, too."""
_NODES = np.array([-np.sqrt(3.0), 0.0, np.sqrt(3.0)])
_WEIGHTS = np.array([1.0, 4.0, 1.0]) / 6.0
"""Gauss-Hermite quadrature of a normal return."""


@dataclass
class Adaptive:
    """Chooses a policy for each episode in a context that nobody tells.

    `serving = portfolio.adaptive()`, and for each episode
    `serving.observe(play(serving.policy))` with its return. With `signs`, `serving.policy` acts in
    each step, which is told by `serving.step(observation, action, reward)`.

    Attributes:
        space: the listed contexts.
        bounds: normalisation of the returns.
        mean: (k, N) what each policy is believed to return where, performance.
        own: (k, N) deviations of single episodes (`deviations`).
        load: position -> policy.
        episodes: how many are expected in this context; the more, the more is tried out.
        forget: chance per episode that the context has changed.
        signs: what policies show within an episode; None: only returns count.
        chances: (N,) of the listed contexts.
        played: policies, the last ones of their episodes, and raw returns so far.
    """

    space: ContextSpace = field(repr=False)
    bounds: Bounds = field(repr=False)
    mean: Array = field(repr=False)
    own: Array = field(repr=False)
    load: Callable[[int], Any] = field(repr=False)
    episodes: int = 10
    forget: float = 0.0
    signs: Signs | None = field(default=None, repr=False)
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
        self._playing: int | None = None  # in the running episode
        self._part, self._steps = 0, list[Step]()

    # ---- what to play ------------------------------------------------------------------------

    @property
    def next(self) -> int:
        """Position of the policy to play in the next episode, or part; the first of equals."""
        if self._playing is not None:
            return self._playing
        expected = self.mean @ self.chances
        left = min(self.episodes - len(self.played) - 1, _AHEAD)
        if self.signs is None and left > 0 and len(expected) > 1:
            expected = expected + left * self._taught(float(expected.max()))
        return argmax_open(expected, np.ones(len(expected), dtype=bool))

    @property
    def policy(self) -> Any:
        """The policy to play in the next episode, or part."""
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

    def step(self, observation: Any, action: Any, reward: float) -> None:
        """Learn from a step of `policy` in an episode, which `observe` ends; only with `signs`.

        Args:
            observation: that the policy saw.
            action: what it did.
            reward: of the step, raw.

        Raises:
            InvalidInput: rewards or features of a part are not finite.
        """
        if self.signs is None:
            return
        self._playing = self.next
        self._steps.append((np.array(observation), np.array(action), float(reward)))
        if len(self._steps) == self.signs.every:
            self._learn(self.signs)

    def observe(self, value: float, policy: int | None = None) -> None:
        """Learn from an episode. Where its steps were told, they count, and its return does not.

        Args:
            value: its return, raw.
            policy: position of the policy that was played; missing: that of the steps, or `next`.

        Raises:
            InvalidInput: the return is not finite, or there is no such policy.
        """
        which = self.next if policy is None else policy
        number = np.ndim(value) == 0 and np.asarray(value).dtype.kind in "biuf"
        if not (number and np.isfinite(value) and 0 <= which < len(self.mean)):
            raise InvalidInput(
                f"an episode has a finite return and a policy of 0 to {len(self.mean) - 1}, "
                f"got {value!r} of policy {which}"
            )
        if self.signs is None or self._playing is None:
            seen = self.bounds.normalise(np.array([float(value)]))
            told = self.chances * self._likelihood(which, seen)[0]
            self.chances = told / told.sum()
        else:
            if self._steps:
                self._learn(self.signs)
            self._playing, self._part = None, 0
        self.played.append((which, float(value)))
        if self.forget:
            prior = self.space.weights
            self.chances = (1.0 - self.forget) * self.chances + self.forget * prior

    # ---- inside ------------------------------------------------------------------------------

    def _learn(self, signs: Signs) -> None:
        """Let a part, perhaps cut short, tell the context and who plays the next one."""
        steps, self._steps = self._steps, []
        if self._part < signs.mean.shape[2]:  # no episode that was recorded lasted longer
            self._weigh(signs, shown(steps, signs.every, signs.features))

    def _weigh(self, signs: Signs, seen: Array) -> None:
        """The same, by the vector of the part, as far as it was recorded."""
        seen = seen[: signs.mean.shape[3]]
        here = (self.next, slice(None), self._part, slice(len(seen)))
        width = signs.width[: len(seen)]
        deviation = np.hypot(signs.deviation[here], _BLUR * width)
        chance = np.log(_density(seen, signs.mean[here], deviation, width)).sum(axis=1)
        told = self.chances * np.exp(chance - chance.max())
        told = np.where(self.space.weights > 0.0, np.maximum(told, _NEVER), 0.0)
        self.chances = told / told.sum()
        self._part += 1
        to_go = signs.to_go[:, :, self._part] @ self.chances
        expected = to_go if self.bounds.direction == "maximize" else -to_go
        if expected[self.next] < expected.max() - TIE * max(1.0, float(np.abs(expected).max())):
            self._playing = int(expected.argmax())

    def _likelihood(self, policy: int, seen: Array) -> Array:
        """(R, N) of performances `seen`, (R,)."""
        return _density(seen[:, None], self.mean[policy], self._deviation[policy], self._range)

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


def _density(seen: Array, mean: Array, deviation: Array, width: float | Array) -> Array:
    """Normal, but for the chance of something odd; that alone where no mean is known (NaN)."""
    normal = np.exp(-0.5 * ((seen - mean) / deviation) ** 2) / (np.sqrt(2.0 * np.pi) * deviation)
    return np.asarray((1.0 - _ODD) * np.nan_to_num(normal) + _ODD / width)


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
