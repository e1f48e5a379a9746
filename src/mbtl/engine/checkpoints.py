"""Names of the policies that one training leaves behind.

    best        of all evaluations on the own context
    final       after the last update
    best@1/8    best so far after an eighth of the training
    last@1/8    the latest after an eighth of it
    last@1      the latest at its end, which comes early where nothing is left to gain

`final` makes a training run to its last update; the others let it end early.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from mbtl.errors import InvalidInput


@dataclass(frozen=True)
class Checkpoint:
    """One policy of a training.

    Attributes:
        kind: "best", "final" or "last".
        share: of the training, 0 < share <= 1; 1 is its end.
    """

    kind: str
    share: Fraction = Fraction(1)

    @classmethod
    def named(cls, name: str) -> Checkpoint:
        """The checkpoint of a name.

        Raises:
            InvalidInput: there is none.
        """
        kind, _, share = name.partition("@")
        if name in ("best", "final"):
            return cls(name)
        try:
            found = cls(kind, Fraction(share))
            if kind in ("best", "last") and 0 < found.share <= 1:
                return found
        except (ValueError, ZeroDivisionError):
            pass
        raise InvalidInput(
            f"a checkpoint is 'best', 'final', or 'best' or 'last' with a share of the training "
            f"such as 'last@1/8', got {name!r}"
        )

    @property
    def on_the_way(self) -> bool:
        """Whether it must be kept while the training goes on."""
        return self.share < 1

    def __str__(self) -> str:
        return self.kind if self.kind != "last" and self.share == 1 else f"{self.kind}@{self.share}"


def shares_of(names: Sequence[str]) -> list[Fraction]:
    """Shares of a training at which weights must be kept for these checkpoints, rising."""
    checkpoints = map(Checkpoint.named, names)
    return sorted({one.share for one in checkpoints if one.on_the_way})


@dataclass(frozen=True)
class Along:
    """Rows along a training, at 1/2^halvings, ..., 1/4, 1/2 of it and at its end.

    Attributes:
        episodes: of each.
        halvings: shortest length.
    """

    episodes: int
    halvings: int = 6

    def __post_init__(self) -> None:
        if self.episodes < 2 or self.halvings < 0:
            raise InvalidInput(
                "rows along a training need 2 episodes or more and 0 halvings or more, got "
                f"{self.episodes} and {self.halvings}"
            )

    @property
    def shares(self) -> list[Fraction]:
        """Of the training, rising; the last is 1."""
        return [Fraction(1, 2**halving) for halving in range(self.halvings, -1, -1)]

    @property
    def names(self) -> dict[str, list[str]]:
        """Checkpoints by kind, "best" and "last", in the order of `shares`."""
        return {k: [str(Checkpoint(k, share)) for share in self.shares] for k in ("best", "last")}
