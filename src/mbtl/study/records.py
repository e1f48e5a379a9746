"""What the log says of picks, rows, failures and reports: one record each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mbtl.arrays import Array
from mbtl.study.worker import Worker


@dataclass(frozen=True)
class PickRecord:
    """One proposal of the selector, as logged."""

    number: int
    source: int
    reason: str
    acquisition: float | None
    notes: tuple[str, ...]
    worker: Worker | None
    asked_at: float
    repeat: int = 0
    targets: tuple[int, ...] | None = None


@dataclass(frozen=True)
class ToldRow:
    """One transfer row, as logged.

    Attributes:
        source: context index.
        pick: number of the pick it answers; None for a source nobody asked for.
        returns: (N,) mean returns, raw units; NaN where it was not evaluated.
        std: (N,) standard deviation over episodes, with n - 1; NaN for a single episode, and as
            `returns`.
        episodes: episodes behind each mean.
        cost: cost of the training in the user's unit.
        seconds: wall time of training and evaluation; None when unknown.
        policy: folder of the saved policy, relative to the study; None when not saved.
        told_at: seconds since the epoch.
    """

    source: int
    pick: int | None
    returns: Array
    std: Array
    episodes: int
    cost: float
    seconds: float | None
    policy: str | None
    told_at: float


@dataclass(frozen=True)
class Failure:
    """A pick that gave nothing, and why.

    Attributes:
        source: context index.
        pick: 0-based number of the pick.
        reason: the error in one line.
        traceback: where it came from; empty where nobody said.
    """

    source: int
    pick: int
    reason: str
    traceback: str = ""

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Failure:
        """As logged; older logs have no traceback."""
        return cls(data["source"], data["pick"], data["reason"], data.get("traceback", ""))


@dataclass(frozen=True)
class FreshReturns:
    """What the policies gave on fresh episodes, which chose nothing.

    Attributes:
        returns: (k, N) means; NaN where a policy serves nobody.
        value_errors: (k,) standard error of V after each training, raw units; None: unknown.
        episodes: episodes behind each mean; None: unknown.
    """

    returns: Array
    value_errors: Array | None
    episodes: int | None
