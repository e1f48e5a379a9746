"""Priors of the transfer model, and what shipped matrices speak for.

Chosen on families of matrices, and without each of them (evidence/learn_prior.py). A family is the
part of an id before the first "-": all CartPole variations are one. What is reported on a family
must use the choice that has not seen it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from mbtl.models.transfer_kernel import TransferPrior

RATIO = TransferPrior(
    target=0.1, source=0.1, gap=0.05, log_gap=1.0, interaction=0.05, luck=0.05, row_luck=0.03,
    noise=0.002, target_length=0.5, log_gap_length=0.3, along_length=1.5,
)  # fmt: skip
"""How far a policy reaches is a matter of the ratio of contexts."""

PRIORS: Mapping[str, TransferPrior] = {
    "all": RATIO,
    "pendulum": replace(RATIO, log_gap_length=0.15),
}
"""By family that it has not seen, where that is another one than of all."""


def prior_without(family: str) -> TransferPrior:
    """The prior that has not seen `family`."""
    return PRIORS.get(family, PRIORS["all"])
