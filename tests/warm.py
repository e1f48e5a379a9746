"""A study with a tuned copy, and what interrupts it: the same for every engine."""

import mbtl
from mbtl.selectors import Proposal
from scripted import Scripted

WARM = Scripted(
    (
        Proposal(2, "first", length=1.0),
        Proposal(0, "tuned", start=0, length=0.5),
        Proposal(0, "longer", start=1, length=1.0),
    )
)
"""A specialist, a copy of it tuned elsewhere, and that one for longer."""


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
