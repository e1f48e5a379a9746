"""Priors of the transfer model, fitted to shipped matrices: to all, and without each family.

A family is the part of an id before the first "-": all CartPole variations are one. What is
reported on a family must use the prior that has not seen it.
"""

from __future__ import annotations

from collections.abc import Mapping

from mbtl.models.transfer_gp import TransferPrior

# begin: benchmarks/learn_prior.py --write
PRIORS: Mapping[str, TransferPrior] = {
    "all": TransferPrior(
        target=0.1,
        source=0.1,
        gap=0.05,
        log_gap=1,
        interaction=0.05,
        luck=0.05,
        row_luck=0.03,
        noise=0.002,
        target_length=0.5,
        source_length=0.3,
        gap_length=0.2,
        log_gap_length=0.3,
        along_length=1.5,
        row_luck_length=0.1,
    ),  # ratio
    "cartpole": TransferPrior(
        target=0.1,
        source=0.1,
        gap=0.05,
        log_gap=1,
        interaction=0.05,
        luck=0.05,
        row_luck=0.03,
        noise=0.002,
        target_length=0.5,
        source_length=0.3,
        gap_length=0.2,
        log_gap_length=0.3,
        along_length=1.5,
        row_luck_length=0.1,
    ),  # ratio
    "pendulum": TransferPrior(
        target=0.1,
        source=0.1,
        gap=0.05,
        log_gap=1,
        interaction=0.05,
        luck=0.05,
        row_luck=0.03,
        noise=0.002,
        target_length=0.5,
        source_length=0.3,
        gap_length=0.2,
        log_gap_length=0.3,
        along_length=1.5,
        row_luck_length=0.1,
    ),  # ratio
}
# end


def prior_without(family: str) -> TransferPrior:
    """The prior that has not seen `family`; for one that no prior has seen, that of all."""
    return PRIORS.get(family, PRIORS["all"])
