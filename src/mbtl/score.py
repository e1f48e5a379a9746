"""What an episode is worth, where that is not the sum of its rewards."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mbtl.errors import InvalidInput, TrainingFailed
from mbtl.objective import Direction, direction_named

__all__ = ["RANDOM_ACTIONS", "SCORE", "Score"]

SCORE = "score"
"""Of all that is measured of an episode, what it is worth."""
RANDOM_ACTIONS = "random_actions"
"""How any system goes without a policy."""


@dataclass(frozen=True)
class Score:
    """Where an environment tells what an episode is worth; without one it is the sum of rewards.

    Nothing in an environment means anything by its name alone: a CMDP says what counts.

    Attributes:
        key: of the `info` of an episode's last step.
        foretold: of any step's `info`, that tells the score before the end; the rest of the episode
            is then not played in evaluations.
        strata: an attribute of the environment, the shares of the kinds of luck that it knows; they
            add up to 1. An episode is then one of each kind (`reset(options={"stratum": k})`), and
            worth their mean by those shares: as much on average, and with less luck.
        unit: of the score, for people.
        direction: whether larger or smaller scores are better.

    Raises:
        InvalidInput: a name that is no text, or empty.
        UnknownName: another direction.
    """

    key: str
    foretold: str | None = None
    strata: str | None = None
    unit: str = ""
    direction: Direction = "maximize"

    def __post_init__(self) -> None:
        direction_named(self.direction)
        for name in (self.key, self.foretold, self.strata):
            if name is not None and not (isinstance(name, str) and name):
                raise InvalidInput(
                    f"a score is named by a key of the last step's info, got {name!r}; give a text"
                )

    @classmethod
    def of(cls, given: str | Score | None) -> Score | None:
        """A name as a score."""
        return given if given is None or isinstance(given, Score) else cls(given)

    def read(self, info: Mapping[str, Any]) -> float:
        """The score in the `info` of an episode's last step.

        Raises:
            TrainingFailed: it is not there, or no number.
        """
        for key in (self.foretold, self.key):
            if key is not None and key in info:
                return _number(key, info[key])
        raise TrainingFailed(
            f"the info of an episode's last step must hold the score {self.key!r}, got the keys "
            f"{sorted(map(str, info))}; put it there, or name another key"
        )

    def is_foretold(self, info: Mapping[str, Any]) -> bool:
        """Whether the rest of an episode need not be played."""
        return self.foretold is not None and self.foretold in info

    def shares(self, env: Any) -> tuple[float, ...]:
        """Of the kinds of luck that an environment knows; none where it says nothing."""
        if self.strata is None:
            return ()
        find = getattr(env, "get_wrapper_attr", None)
        shares = find(self.strata) if find is not None else getattr(env, self.strata)
        return tuple(shares)

    @property
    def record(self) -> str | dict[str, str]:
        """JSON-able."""
        named = {"foretold": self.foretold, "strata": self.strata}
        more = {name: value for name, value in named.items() if value is not None}
        return {"key": self.key, **more} if more else self.key


def _number(key: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise TrainingFailed(
            f"the score {key!r} of an episode must be a number, got {value!r}; name another key"
        ) from None
