"""Reference rows: what stands beside every table, so that its numbers mean something.

    random actions   a policy that looks at nothing
    unguided         the system without a controller, where there is such a thing
    fixed time,      of signals: lights that need no policy
    actuated
    nominal policy   the policy of the context on which a user would train without help, or of the
                     nearest that was trained on
    random policy    the policy of a random context; the exact mean over all of them

All but the last two are played when a matrix is built, in the episodes of its policies; the others
are rows of the matrix.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mbtl.benchmark.base import RowSource, levels
from mbtl.benchmark.matrix import TransferMatrix
from mbtl.errors import ContextMismatch

NAMES: Mapping[str, str] = {
    "random_actions": "random actions",
    "unguided": "unguided",
    "fixed_time": "fixed time",
    "actuated": "actuated",
    "nominal_policy": "nominal policy",
    "random_policy": "random policy",
}
"""What people are shown, in the order of tables."""


def reference_levels(source: RowSource, seed: int) -> dict[str, float]:
    """V of the reference rows of one matrix seed, performance on fresh episodes.

    Args:
        source: a matrix; of a synthetic world only the random policy is known.
        seed: matrix seed.

    Returns:
        V by name, those of `NAMES` that are known, in its order.
    """
    found = {"random_policy": levels(source, seed).grand_mean}
    if isinstance(source, TransferMatrix):
        weights = source.space.weights
        for name, rows in source.references.items():
            found[name] = float(source.bounds.normalise(rows[seed, -1]) @ weights)
        nominal = nominal_source(source)
        if nominal is not None:
            found["nominal_policy"] = float(source.fresh_rows(seed, [nominal])[0] @ weights)
    return {name: found[name] for name in [*NAMES, *found] if name in found}


def nominal_source(matrix: TransferMatrix) -> int | None:
    """Index of the source nearest to the nominal context, in unit coordinates; None if unknown."""
    nominal = matrix.records[0].get("nominal")
    if nominal is None or set(nominal) != {axis.name for axis in matrix.axes}:
        return None
    try:
        away = np.linalg.norm(matrix.space.unit - matrix.space.encode(nominal), axis=1)
    except ContextMismatch:  # a stranger's file may say anything
        return None
    if matrix.sources is None:
        return int(away.argmin())
    return int(matrix.sources[away[matrix.sources].argmin()])
