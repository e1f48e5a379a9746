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
        target=0.2284,
        source=0.09707,
        gap=0.2238,
        log_gap=1.854,
        interaction=0.08953,
        luck=0.09049,
        row_luck=0.03958,
        noise=0.0005013,
        target_length=0.5591,
        source_length=0.3045,
        gap_length=0.4036,
        log_gap_length=0.1853,
        along_length=0.1402,
        row_luck_length=0.1946,
    ),
    "cartpole": TransferPrior(
        target=0.239,
        source=0.1033,
        gap=0.2395,
        log_gap=3.789,
        interaction=0.09657,
        luck=0.09322,
        row_luck=0.04086,
        noise=0.001166,
        target_length=0.4621,
        source_length=0.2958,
        gap_length=0.341,
        log_gap_length=0.2309,
        along_length=0.09311,
        row_luck_length=0.1168,
    ),
    "pendulum": TransferPrior(
        target=0.1983,
        source=0.09391,
        gap=0.2135,
        log_gap=0.3873,
        interaction=0.09237,
        luck=0.07533,
        row_luck=0.02974,
        noise=0.0004539,
        target_length=0.3965,
        source_length=0.327,
        gap_length=0.3651,
        log_gap_length=0.2745,
        along_length=0.4795,
        row_luck_length=0.1264,
    ),
}
# end


def prior_without(family: str) -> TransferPrior:
    """The prior that has not seen `family`; for one that no prior has seen, that of all."""
    return PRIORS.get(family, PRIORS["all"])
