"""Events: everything that ever happened to a study, in order. State is a replay of them.

created   the problem and the settings; always the first
extended  the budget was raised, or is now to be spent in any case
equipped  a run brought its trainer: recipe and format of the policies, own code, and which
          changes of that were accepted
claimed   a worker holds a pick from now on: one that is open, or the next, which it proposes
asked     the strategy proposed the pick that was claimed
released  a pick was given back untrained
told      a transfer row arrived, or further entries of one
late      a result came of a pick that is somebody else's by now, or answered; it changes nothing
voided    a row that was told is wrong and does not count any more
deferred  a policy is trained and could not be evaluated; its pick stays open
failed    a training gave nothing that can be used; or is begun `again`, with another seed
reopened  a failed pick is to be tried again, with another seed
stopped   the strategy predicts too little gain from one more training
reported  returns on fresh evaluation seeds, for the V that people are told
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from mbtl.arrays import Array

Kind = Literal[
    "created", "extended", "equipped", "asked", "claimed", "released", "told", "late", "voided",
    "deferred", "failed", "reopened", "stopped", "reported",
]  # fmt: skip
KINDS: tuple[str, ...] = get_args(Kind)


@dataclass(frozen=True)
class Event:
    """One entry of the log.

    Attributes:
        kind: what happened.
        data: JSON-able facts.
        arrays: numbers that are too many for JSON, by name.
        seq: position in the log, from 1; 0 before it is appended.
        time: seconds since the epoch, when it was appended.
    """

    kind: Kind
    data: Mapping[str, Any]
    arrays: Mapping[str, Array] = field(default_factory=dict)
    seq: int = 0
    time: float = 0.0
