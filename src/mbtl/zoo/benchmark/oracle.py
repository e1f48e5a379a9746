"""What needs the whole matrix: the Sequential Oracle, and Random's exact expectation.

They are the two ends of the scale that selectors are measured on, and no selector may see what they
see; that is why they live here and not among the selectors.

Like a selector, they choose by the half of the episodes that a selector may see; what they reach is
measured on the other (`mbtl.zoo.benchmark.base`).

Notation (shapes): N contexts, M of them sources, K trainings.
    curve  (K,)  V_1..V_K, performance on fresh episodes
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import ContextMismatch, InvalidInput
from mbtl.objective import value
from mbtl.report.reference import REFERENCE_NAMES
from mbtl.zoo.benchmark.base import (
    BLOCK_BYTES,
    Levels,
    RowSource,
    levels,
    measured_curve,
    ranked_blocks,
)
from mbtl.zoo.benchmark.matrix import TransferMatrix

# ---- reference rows: what stands beside every table, so that its numbers mean something ------
#
#     random actions   a policy that looks at nothing
#     unguided         the system without a controller, where there is such a thing
#     fixed time,      of signals: lights that need no policy
#     actuated
#     nominal policy   the policy of the context on which a user would train without help, or of the
#                      nearest that was trained on
#     random policy    the policy of a random context; the exact mean over all of them
#
# All but the last two are played when a matrix is built, in the episodes of its policies; the
# others are rows of the matrix.


def reference_levels(source: RowSource, seed: int) -> dict[str, float]:
    """V of the reference rows of one matrix seed, performance on fresh episodes.

    Args:
        source: a matrix; of a synthetic world only the random policy is known.
        seed: matrix seed.

    Returns:
        V by name, those of `REFERENCE_NAMES` that are known, in its order.
    """
    found = {"random_policy": levels(source, seed).grand_mean}
    if isinstance(source, TransferMatrix):
        weights = source.space.weights
        for name, rows in source.references.items():
            found[name] = float(source.bounds.normalise(rows[seed, -1]) @ weights)
        nominal = nominal_source(source)
        if nominal is not None:
            found["nominal_policy"] = float(source.fresh_rows(seed, [nominal])[0] @ weights)
    return {name: found[name] for name in [*REFERENCE_NAMES, *found] if name in found}


def nominal_source(matrix: TransferMatrix) -> int | None:
    """Index of the source nearest to the nominal context, in unit coordinates; None if unknown."""
    nominal = matrix.records[0].get("nominal")
    if nominal is None or set(nominal) != {axis.name for axis in matrix.axes}:
        return None
    try:
        away = np.linalg.norm(matrix.space.unit - matrix.space.encode(nominal), axis=1)
    except ContextMismatch:  # a stranger's file may say anything
        return None
    return int(matrix.trained[away[matrix.trained].argmin()])


# ---- the whole -------------------------------------------------------------------------------


_ROUNDING = 1e-12  # slack of the bounds, far above the rounding of a mean


@dataclass(frozen=True)
class OracleRun:
    """The Sequential Oracle on one matrix seed.

    Attributes:
        sources: (K,) picks in order.
        curve: (K,) V after each.
        seconds: wall time.
    """

    sources: tuple[int, ...]
    curve: Array
    seconds: float


@dataclass(frozen=True)
class Reference:
    """Everything that one matrix seed is compared against.

    Attributes:
        levels: Independent, Oracle Transfer, grand mean.
        random: (K,) expectation of V over uniformly random orders, exact.
        oracle: the Sequential Oracle.
        rows: V of the reference rows by name.
    """

    levels: Levels
    random: Array
    oracle: OracleRun
    rows: Mapping[str, float] = field(default_factory=dict)


def reference(source: RowSource, seed: int, budget: int) -> Reference:
    """Reference levels and curves of one matrix seed for K = `budget`."""
    return Reference(
        levels(source, seed),
        random_curve(source, seed, budget),
        sequential_oracle(source, seed, budget),
        reference_levels(source, seed),
    )


def sequential_oracle(source: RowSource, seed: int, budget: int) -> OracleRun:
    """Greedy on the whole matrix: x_k = argmax_x V(x; pi_1:k-1), the first index of equal values.

    It chooses by the episodes that a selector may see; the curve is of the others. Myopic, hence no
    upper bound. The gain of a row can only shrink as others are trained, so a row is looked at
    again only while its last known gain could still win ("lazy greedy", Minoux 1978); the picks are
    those of the full search, and memory is bounded by blocks of rows.

    Values are compared as computed, without a tolerance: rows that tie in exact arithmetic (73 and
    74 at the ninth pick of the linear-gap world of N = 100) are told apart by the rounding of the
    mean, which gives 74 there, as in the test vector of that world.
    """
    start = time.perf_counter()
    problem = source.problem(budget)
    weights = None if problem.uniform_weights else problem.weights
    block = max(1, min(256, BLOCK_BYTES // (16 * source.n)))
    taken: list[int] = []
    curve: list[float] = []
    best = np.full(source.n, -np.inf)
    ceiling = np.full(source.n, -np.inf)  # upper bound of every row's gain in V
    ceiling[problem.sources] = np.inf
    for _ in range(budget):
        now = curve[-1] if curve else 0.0
        ceiling[taken] = -np.inf
        reached = np.full(source.n, -np.inf)
        order = np.argsort(-ceiling, kind="stable")
        for first in range(0, source.n, block):
            group = order[first : first + block]
            hopeful = now + ceiling[group] >= reached.max() - _ROUNDING
            group = group[hopeful & (ceiling[group] > -np.inf)]
            if group.size == 0:
                break
            rows = np.maximum(source.rows(seed, group), best)
            reached[group] = rows.mean(axis=1) if weights is None else rows @ weights
        # The first value is no gain over anything and bounds no later gain.
        if curve:
            looked = np.isfinite(reached)
            ceiling[looked] = reached[looked] - now
        pick = int(np.argmax(reached))
        best = np.maximum(best, source.rows(seed, [pick])[0])
        taken.append(pick)
        curve.append(value(best, weights))
    seconds = time.perf_counter() - start
    measured = measured_curve(source, seed, taken) if source.measures_apart else np.asarray(curve)
    return OracleRun(tuple(taken), measured, seconds)


def random_weights(n: int, budget: int) -> Array:
    """Chance that the best of k random policies is the r-th best of all: C(N-r, k-1) / C(N, k).

    Computed by the ratio of neighbours, w(k, 1) = k/N and w(k, r+1) / w(k, r) = (N-r-k+1) / (N-r),
    which has no large numbers in it and ends at an exact zero.

    Args:
        n: number of policies N.
        budget: K, from 1 to N.

    Returns:
        (K, N) weights for k = 1..K and r = 1..N; each row sums to 1.
    """
    if not 1 <= budget <= n:
        raise InvalidInput(f"budget must be from 1 to the number of contexts ({n}), got {budget}")
    k = np.arange(1, budget + 1, dtype=np.float64)[:, None]
    r = np.arange(1, n, dtype=np.float64)
    ratios = np.maximum(n - r - k + 1.0, 0.0) / (n - r)
    return np.asarray(np.cumprod(np.hstack([k / n, ratios]), axis=1))


def random_curve(source: RowSource, seed: int, budget: int) -> Array:
    """Expected V of k policies on distinct, uniformly random contexts, for k = 1..K; exact.

    Per target, with its policies in the order a_1, ..., a_N in which they would serve it:
    sum_r a_r C(N-r, k-1) / C(N, k); then the weighted mean over targets.
    """
    problem = source.problem(budget)
    chance, weights = random_weights(len(problem.sources), budget), problem.weights
    curve = np.zeros(budget)
    for targets, ranked in ranked_blocks(source, seed, block_bytes=BLOCK_BYTES):
        curve += chance @ (weights[targets] @ ranked)[::-1]
    return curve
