"""Acquisition: formulas over posteriors, and the argmax over a finite set."""

from mbtl.acquisition.choose import TIE, argmax_open
from mbtl.acquisition.gain import expected_gain, optimistic_gain, unit_improvement
from mbtl.acquisition.line import line_gain, linear_gap_gain
from mbtl.acquisition.row_gain import RowGain

__all__ = [
    "TIE",
    "RowGain",
    "argmax_open",
    "expected_gain",
    "line_gain",
    "linear_gap_gain",
    "optimistic_gain",
    "unit_improvement",
]
