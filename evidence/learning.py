"""What `twin_learning.py` and `sumo_learning.py` share: trainings, each judged on all contexts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from measure import note

"""Seed of all evaluations."""


class Trained(NamedTuple):
    """A policy, the context trained on, the score there and the mean score on the others."""

    policy: Any
    context: Any
    own: float
    others: float


def trainings(name: str, trainer: Any, contexts: Sequence[Any], seeds: int) -> Iterator[Trained]:
    """`seeds` trainings on each context, which is said as it begins."""
    for k, context in enumerate(contexts):
        for seed in range(seeds):
            place = ", ".join(f"{axis} {value:g}" for axis, value in context.items())
            note(f"{name}, {place}, seed {seed} ...")
            policy = trainer.train([context], seed).policy
            scores = trainer.evaluate(policy, contexts, range(len(contexts))).mean(axis=1)
            others = (scores.sum() - scores[k]) / (len(scores) - 1)
            yield Trained(policy, context, float(scores[k]), float(others))
