"""One policy: all contexts, ever longer; the paper's multi-task baseline at any budget."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mbtl.history import History
from mbtl.selectors.base import Exhausted, Proposal, SelectionProblem
from mbtl.selectors.contract import Traits
from mbtl.strategies.all_first import on_all

_LEAST = 1e-3
"""Units that are worth going on for."""


@dataclass(frozen=True)
class OnePolicy:
    """One training on all contexts that goes on, twice as long each time.

    Attributes:
        name: what results call it.
    """

    name: str = "one-policy"
    traits: ClassVar[Traits] = Traits(deterministic=True, any_training=True)

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """Begin, or go on to twice the length, or as far as the budget goes.

        Raises:
            Exhausted: the training is under way, has failed, or cannot go on.
        """
        if (first := on_all(problem, history)) is not None:
            return first
        abilities = problem.abilities or frozenset()
        if "sets" not in abilities:
            raise Exhausted("the trainer takes one context at a time, so there is no such policy")
        if history.under_way or history.given_up or not len(history):
            raise Exhausted("the one policy is in training, or its training failed")
        last = max(range(len(history)), key=lambda row: (history.made(row).length, row))
        made, left = history.made(last), problem.budget - history.paid
        if not {"start", "length"} <= abilities:
            raise Exhausted("this trainer cannot go on with a policy")
        if left < _LEAST:
            raise Exhausted("of the budget there is nothing left to go on with")
        length = min(2.0 * made.length, made.length + left)
        reason = "twice as long" if length == 2.0 * made.length else "as long as the budget goes"
        source = history.sources[last]
        return Proposal(source, reason, start=last, length=length, sources=made.contexts)
