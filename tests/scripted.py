"""A strategy that does as it is told."""

from dataclasses import dataclass
from typing import ClassVar

from mbtl.selectors import Exhausted, Traits


@dataclass(frozen=True)
class Scripted:
    """Asks for one proposal after the other, whatever came of those before."""

    script: tuple
    name: str = "scripted"
    traits: ClassVar[Traits] = Traits(any_training=True)

    def propose(self, problem, history, rng):
        asked = len(history.asked)
        if asked == len(self.script):
            raise Exhausted("the script is over")
        return self.script[asked]
