"""What the paper claims in its abstract and text, and a verdict on each by a rule stated here.

A verdict is computed from the numbers of the items, never typed. Each claim says its rule.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from mbtl.reproduction.claims.claim import NOT, OPEN, PARTLY, REPRODUCED, Claim
from mbtl.reproduction.claims.matrices import (
    of_correlation,
    of_elimination,
    of_gp_study,
    of_heatmaps,
    of_rivals,
)
from mbtl.reproduction.claims.selection import of_curves, of_efficiency, of_sensitivity, of_table
from mbtl.reproduction.item import Numbers

__all__ = ["NOT", "OPEN", "PARTLY", "REPRODUCED", "Claim", "claims_of"]

_CLAIMS: tuple[tuple[str, Callable[[Numbers], list[Claim]]], ...] = (
    ("sample-complexity", of_efficiency),
    ("main-table", of_table),
    ("curves", of_curves),
    ("sensitivity", of_sensitivity),
    ("elimination", of_elimination),
    ("gap-correlation", of_correlation),
    ("heatmaps", of_heatmaps),
    ("multitask-rivals", of_rivals),
    ("gp-study", of_gp_study),
)


def claims_of(numbers: Mapping[str, Numbers]) -> list[Claim]:
    """The claims whose items are there, in the paper's order."""
    return [
        claim for needs, judge in _CLAIMS if needs in numbers for claim in judge(numbers[needs])
    ]
