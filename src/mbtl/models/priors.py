"""Priors of the transfer model, and what shipped matrices speak for.

Chosen on families of matrices, and without each of them. A family is the part of an id before the
first "-": all CartPole variations are one. What is reported on a family must use the choice that
has not seen it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from mbtl.models.transfer_kernel import TransferPrior

_RATIO = TransferPrior(
    target=0.1, source=0.1, gap=0.05, log_gap=1.0, interaction=0.05, luck=0.05, row_luck=0.03,
    noise=0.002, target_length=0.5, log_gap_length=0.3, along_length=1.5,
)  # fmt: skip
CANDIDATES: Mapping[str, TransferPrior] = {
    "ratio": _RATIO,
    "ratio, short": replace(_RATIO, log_gap_length=0.15),
    "ratio, long": replace(_RATIO, log_gap_length=0.6),
    "ratio, changing": replace(_RATIO, along_length=0.5),
    "ratio, rigid": replace(_RATIO, along_length=4.0),
    "ratio, hard targets": replace(_RATIO, target=0.4),
    "ratio, good sources": replace(_RATIO, source=0.4),
    "ratio, luck": replace(_RATIO, luck=0.2, row_luck=0.1),
    "difference": replace(_RATIO, gap=1.0, gap_length=0.3, log_gap=0.05),
    "both": replace(_RATIO, gap=0.5, gap_length=0.3),
    "targets": replace(_RATIO, log_gap=0.05, target=1.0, source=0.3, interaction=0.3, luck=0.1),
}
"""How far a policy reaches is a matter of the ratio of contexts, of their difference, or both; or
targets are hard or easy whatever the source."""

# what evidence/learn_prior.py prints
CHOSEN: Mapping[str, str] = {
    "all": "ratio",
    "cartpole": "ratio",
    "eco": "ratio",
    "pendulum": "ratio, short",
    "ramp": "ratio",
    "ring": "ratio",
    "signal": "ratio",
}

PRIORS: Mapping[str, TransferPrior] = {f: CANDIDATES[label] for f, label in CHOSEN.items()}


def prior_without(family: str) -> TransferPrior:
    """The prior that has not seen `family`; for one that no prior has seen, that of all."""
    return PRIORS.get(family, PRIORS["all"])
