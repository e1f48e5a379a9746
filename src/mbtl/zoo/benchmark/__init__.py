"""Tabular benchmark: selectors on known transfer matrices, without any training."""

from mbtl.zoo.benchmark.base import Levels, RowSource, levels
from mbtl.zoo.benchmark.compare import compare
from mbtl.zoo.benchmark.comparison import Comparison, Run, Summary, summarise
from mbtl.zoo.benchmark.matrix import TransferMatrix
from mbtl.zoo.benchmark.oracle import (
    OracleRun,
    Reference,
    nominal_source,
    random_curve,
    reference,
    reference_levels,
    sequential_oracle,
)
from mbtl.zoo.benchmark.shipped import (
    load_matrix,
    open_matrix,
    save_shipped,
    shipped_matrices,
    synthetic_ids,
    synthetic_world,
)
from mbtl.zoo.benchmark.synthetic import SyntheticWorld, linear_gap_world
from mbtl.zoo.benchmark.transfers import TransferData, load_transfers, transfer_ids

__all__ = [
    "Comparison",
    "Levels",
    "OracleRun",
    "Reference",
    "RowSource",
    "Run",
    "Summary",
    "SyntheticWorld",
    "TransferData",
    "TransferMatrix",
    "compare",
    "levels",
    "linear_gap_world",
    "load_matrix",
    "load_transfers",
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
    "transfer_ids",
]
