"""Tabular benchmark: selectors on known transfer matrices, without any training."""

from mbtl.benchmark.base import Levels, RowSource, levels
from mbtl.benchmark.catalogue import open_matrix, synthetic_ids, synthetic_world
from mbtl.benchmark.compare import compare
from mbtl.benchmark.comparison import Comparison
from mbtl.benchmark.curves import TransferCurves, load_curves
from mbtl.benchmark.matrix import TransferMatrix
from mbtl.benchmark.oracle import (
    OracleRun,
    Reference,
    random_curve,
    reference,
    sequential_oracle,
)
from mbtl.benchmark.records import Run, Summary
from mbtl.benchmark.references import nominal_source, reference_levels
from mbtl.benchmark.shipped import load_matrix, save_shipped, shipped_matrices
from mbtl.benchmark.summary import summarise
from mbtl.benchmark.synthetic import SyntheticWorld, linear_gap_world

__all__ = [
    "Comparison",
    "Levels",
    "OracleRun",
    "Reference",
    "RowSource",
    "Run",
    "Summary",
    "SyntheticWorld",
    "TransferCurves",
    "TransferMatrix",
    "compare",
    "levels",
    "linear_gap_world",
    "load_curves",
    "load_matrix",
    "nominal_source",
    "open_matrix",
    "random_curve",
    "reference",
    "reference_levels",
    "save_shipped",
    "sequential_oracle",
    "shipped_matrices",
    "summarise",
    "synthetic_ids",
    "synthetic_world",
]
