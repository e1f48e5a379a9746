"""A study with a tuned copy, and what interrupts it: the same for every engine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mbtl
from mbtl.selectors import Exhausted, Proposal, Traits


@dataclass(frozen=True)
class Warm:
    """A specialist, a copy of it tuned elsewhere, and that one for longer."""

    name: str = "warm"
    traits: ClassVar[Traits] = Traits(any_training=True)

    def propose(self, problem, history, rng):
        script = (
            Proposal(2, "first", length=1.0),
            Proposal(0, "tuned", start=0, length=0.5),
            Proposal(0, "longer", start=1, length=1.0),
        )
        if len(history) == len(script):
            raise Exhausted("all is trained")
        return script[len(history)]


class Stops(mbtl.Callback):
    """Before the tuned copy is trained, and within it where the trainer tells of it."""

    def __init__(self):
        self.left = 2

    def on_pick(self, study, pick):
        if pick.number == 1 and self.left == 2:
            self.left = 1
            raise KeyboardInterrupt

    def on_progress(self, study, pick, progress):
        if pick.number == 1 and self.left == 1:
            self.left = 0
            raise KeyboardInterrupt
