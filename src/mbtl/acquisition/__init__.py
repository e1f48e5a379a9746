"""Acquisition: formulas over posteriors, and the argmax over a finite set."""

from mbtl.acquisition.gain import (
    TIE,
    argmax_open,
    expected_gain,
    optimistic_gain,
    unit_improvement,
)
from mbtl.acquisition.row_gain import RowGain

__all__ = [
    "TIE",
    "RowGain",
    "argmax_open",
    "expected_gain",
    "optimistic_gain",
    "unit_improvement",
]
