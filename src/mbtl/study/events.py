"""Events: everything that ever happened to a study, in order. State is a replay of them.

created   the problem and the settings; always the first
extended  the budget was raised
equipped  a run brought its trainer: recipe and format of the policies, own code, and which
          changes of that were accepted
claimed   a worker holds a pick from now on: one that is open, or the next, whose source it proposes
asked     the selector proposed the source of the pick that was claimed, and perhaps some ahead; or
          a worker holds the first of those from now on
released  a pick was given back untrained
told      a transfer row arrived
late      a result came of a pick that is somebody else's by now, or answered; it changes nothing
voided    a row that was told is wrong and does not count any more
deferred  a policy is trained and could not be evaluated; its pick stays open
failed    a training gave nothing that can be used
retried   a training failed and is begun again, with another seed, by whoever holds its pick
reopened  a failed pick is to be tried again, with another seed
stopped   the selector predicts too little gain from one more training
reported  returns on fresh evaluation seeds, for the V that people are told

A study that counts steps (`mbtl.study.steps`) has `opened` in place of `created`, and

decided   its strategy chose an action
trained   a training passed a mark, and its policy is kept
evaluated a policy was evaluated on some targets
claimed   a worker is at an action from now on that nobody works on any more
released  a worker gave an action back; what of it is done stays
halted    a training stops short of where it was sent, since no more steps are left
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from mbtl.arrays import Array

Kind = Literal[
    "created",
    "extended",
    "equipped",
    "asked",
    "claimed",
    "released",
    "told",
    "late",
    "voided",
    "deferred",
    "failed",
    "retried",
    "reopened",
    "stopped",
    "reported",
    "opened",
    "decided",
    "trained",
    "evaluated",
    "halted",
]
KINDS: tuple[str, ...] = get_args(Kind)
OPENED: Kind = "opened"


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
