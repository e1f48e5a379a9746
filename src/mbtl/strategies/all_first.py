"""All first: one policy for all contexts, then specialists where a selector says."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from mbtl.contexts import middle_of
from mbtl.history import History
from mbtl.selectors.base import Proposal, SelectionProblem
from mbtl.selectors.contract import Selector, Traits, without_family
from mbtl.selectors.random import Random


@dataclass(frozen=True)
class AllFirst:
    """The first unit goes to one policy for all contexts, the others to specialists.

    On 17 of 22 CMDPs three units are worth more so than three random specialists. Where the trainer
    takes one context at a time, or that training gives nothing, there are only specialists.

    Attributes:
        selector: chooses their contexts; of the policy for all it knows what that is worth.
        name: what results call it.
    """

    selector: Selector = field(default_factory=Random)
    name: str = "all-first"
    traits: ClassVar[Traits] = Traits(any_training=True)

    def without(self, family: str) -> AllFirst:
        """The same, had its selector never seen a family of problems; for honest benchmarks."""
        return replace(self, selector=without_family(self.selector, family))

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """All contexts, if that was not tried; else what the selector says."""
        if (first := on_all(problem, history)) is not None:
            return first
        return self.selector.propose(problem.alone, history.specialists(), rng)


def on_all(problem: SelectionProblem, history: History, *, again: bool = False) -> Proposal | None:
    """One policy for all contexts; None: that was tried, or cannot be.

    A crash may be a passing one: on request it is tried once more, for half as long.
    """
    everyone = tuple(problem.sources.tolist())
    abilities = problem.abilities or frozenset()
    if "sets" not in abilities or len(everyone) < 2:
        return None
    if any(one.contexts == everyone for one in (*history.trainings, *history.under_way)):
        return None
    middle = middle_of(everyone, problem.steps)
    # asked for by its length, the training can go on later
    length = 1.0 if "length" in abilities else None
    first = Proposal(middle, "all contexts first", length=length, sources=everyone)
    vain = [one for one in history.given_up if one.contexts == everyone]
    if not vain:
        return first
    if not again or length is None or len(vain) > 1 or vain[0].start is not None:
        return None
    note = "the policy for all contexts gave nothing: half as long once more"
    return replace(first, length=vain[0].length / 2.0, notes=(note,))
