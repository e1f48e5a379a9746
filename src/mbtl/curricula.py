"""Curricula: in which contexts one policy for all of them should begin its next episodes.

A curriculum is a pure function from what recent episodes gave to a weight of each context. It
knows arrays of NumPy and of jax alike, so it can be compiled into a training
(`mbtl.worlds.taught`). Without one, contexts take turns: domain randomisation.

Notation (shapes): N contexts; all arrays (N,); weights are >= 0 and sum to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from mbtl.errors import InvalidInput, unknown_name
from mbtl.plain import is_finite, short


class Outcomes(NamedTuple):
    """What the episodes of each context gave, (N,) each.

    Attributes:
        performance: mean over recent episodes.
        best: largest performance of one episode so far.
        success: share of recent episodes that succeeded; None where there is no such thing.
        age: episodes of all contexts since the last one of this context ended.
    """

    performance: Any
    best: Any
    success: Any
    age: Any


class Curriculum(Protocol):
    """A rule; hashable, as it is compiled in. Its `repr` is its record."""

    def weights(self, outcomes: Outcomes) -> Any:
        """(N,) how often the next episodes should be in each context."""
        ...


@dataclass(frozen=True)
class Learnability:
    """Where the policy sometimes succeeds: p (1 - p), p the rate of success.

        w = uniform / N + (1 - uniform) p (1 - p) / sum p (1 - p)

    Where no episode succeeds or fails, p is mean performance, cut to [0, 1]: p (1 - p) is then the
    largest variance that episodes within [0, 1] with this mean can have, and equals it where they
    end at 0 or 1. (Their own variance would measure the luck of the first state instead.)

    Attributes:
        uniform: share of the episodes that is spread evenly; of the paper's copies, half.
        of_success: p is the rate of success where there is one, as in the paper; False: mean
            performance everywhere.

    Raises:
        InvalidInput: it is not within [0, 1].

    Source: Rutherford et al., "No Regrets: Investigating and Improving Regret Approximations for
        Curriculum Discovery", NeurIPS 2024. There the contexts without end are scored by extra
        episodes, and the best hundred are drawn evenly; here there are few, and episodes of the
        training score them.
    """

    uniform: float = 0.5
    of_success: bool = True

    def __post_init__(self) -> None:
        _check_share("uniform", self.uniform)

    def weights(self, outcomes: Outcomes) -> Any:
        """See above; even where p (1 - p) is 0 everywhere."""
        p = outcomes.success if self.of_success else None
        p = outcomes.performance if p is None else p
        return _mixed(self.uniform, _shares(learnability(p)))


@dataclass(frozen=True)
class Regret:
    """Where the policy was better once: prioritized level replay with ranks of MaxMC's regret.

        w = uniform / N + (1 - uniform) ((1 - staleness) P_rank + staleness P_age)
        P_rank ~ rank(best - performance)^(-1 / temperature),   P_age ~ age

    The regret of a context is the best return of an episode so far less that of recent ones.

    Attributes:
        uniform: share of the episodes that is spread evenly: what is not replayed, half.
        temperature: the smaller, the more goes to the first rank.
        staleness: share of what is replayed that goes to contexts that were not played for long.

    Raises:
        InvalidInput: a share is not within [0, 1], or the temperature not positive.

    Source: Jiang, Grefenstette, Rocktaeschel, "Prioritized Level Replay", ICML 2021 (ranks,
        staleness); Jiang et al., "Replay-Guided Adversarial Environment Design", NeurIPS 2021
        (MaxMC, half of the levels are new; temperature and staleness as in its code for mazes).
        There the critic's values stand for the present return, which here is that of recent
        episodes; and new levels are only scored, while every episode is learnt from here.
    """

    uniform: float = 0.5
    temperature: float = 0.3
    staleness: float = 0.3

    def __post_init__(self) -> None:
        _check_share("uniform", self.uniform)
        _check_share("staleness", self.staleness)
        if not (is_finite(self.temperature) and self.temperature > 0.0):
            raise InvalidInput(
                f"temperature must be finite and > 0, got {short(self.temperature)}; 0.3 is the "
                "paper's"
            )

    def weights(self, outcomes: Outcomes) -> Any:
        """See above."""
        first = ranked(outcomes.best - outcomes.performance, temperature=self.temperature)
        return _mixed(self.uniform, _mixed(self.staleness, first, _shares(outcomes.age)))


CURRICULA: Mapping[str, Callable[[], Curriculum]] = {
    "learnability": Learnability,
    "regret": Regret,
}
"""By name, with the constants of the papers."""


def curriculum_named(name: str) -> Curriculum:
    """The curriculum of a name in `CURRICULA`.

    Raises:
        UnknownName: there is none.
    """
    if name not in CURRICULA:
        raise unknown_name("curriculum", name, CURRICULA)
    return CURRICULA[name]()


def learnability(p: Any) -> Any:
    """Learnability, p (1 - p), of rates of success, or of performance that is cut to [0, 1]."""
    _check_line(p)
    p = p.clip(0.0, 1.0)
    return p * (1.0 - p)


def ranked(scores: Any, *, temperature: float) -> Any:
    """Weights ~ rank^(-1 / temperature), the largest score first; equal scores share a rank."""
    _check_line(scores)
    ranks = 1.0 + (scores[None, :] > scores[:, None]).sum(axis=1)
    return _shares(ranks ** (-1.0 / temperature))


def _shares(parts: Any) -> Any:
    """Parts >= 0 made to sum to 1; even where all are 0."""
    parts = parts + (parts.sum() <= 0.0)
    return parts / parts.sum()


def _mixed(share: float, weights: Any, other: Any = None) -> Any:
    """Weights that leave a share to others, or to all contexts evenly."""
    other = 1.0 / len(weights) if other is None else other
    return (1.0 - share) * weights + share * other


def _check_share(name: str, value: float) -> None:
    if not (is_finite(value) and 0.0 <= value <= 1.0):
        raise InvalidInput(f"{name} must be a share within [0, 1], got {short(value)}; try 0.5")


def _check_line(values: Any) -> None:
    if getattr(values, "ndim", 0) != 1 or not len(values):
        raise InvalidInput(
            "a curriculum takes one number per context, an array of shape (N,) with N >= 1, got "
            f"shape {getattr(values, 'shape', ())}"
        )
