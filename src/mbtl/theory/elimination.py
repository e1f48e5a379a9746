"""Search-space elimination: which targets can still gain from the k-th training.

Notation (shapes): N contexts, K trainings.
    best       (N,)  J(pi_1:k-1, x'), performance of the best policy so far; -inf before the first
    predicted        Jhat(pi_xk, x_k), predicted training performance of the k-th source
    gap        (N,)  modelled loss theta |x_k - x'| from the source to each target, >= 0
    X_k        (N,)  mask of the targets that the k-th policy may improve
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.arrays import Array
from mbtl.errors import InvalidInput

Form = Literal["corrected", "printed"]
"""The correct formula, or the one the paper prints."""


def search_space(
    best: Array, predicted: float, gap: Array, *, form: Form = "corrected"
) -> NDArray[np.bool_]:
    """Targets that the next policy may improve.

    corrected:  X_k = { x' : J(pi_1:k-1, x') <= Jhat(pi_xk, x_k) - theta |x_k - x'| }
    printed:    X_k = { x' : J(pi_1:k-1, x') <= Jhat(pi_xk, x') - theta |x_k - x'| }

    Jhat(pi_xk, x') already is Jhat(pi_xk, x_k) less the gap, so the printed set subtracts the gap
    twice (slip 1) and is smaller.

    Returns:
        (N,) mask.

    Raises:
        InvalidInput: shapes differ, a gap is negative, or `form` is unknown.
    """
    _check_form(form)
    best, gap = np.asarray(best, dtype=np.float64), np.asarray(gap, dtype=np.float64)
    if best.shape != gap.shape or best.ndim != 1:
        raise InvalidInput(
            f"best and gap must both have shape (N,), got {best.shape} and {gap.shape}"
        )
    if not (gap >= 0).all():
        raise InvalidInput(f"a gap is >= 0, got a minimum of {gap.min()}")
    subtracted = gap if form == "corrected" else 2.0 * gap
    return np.asarray(best <= predicted - subtracted)


def longest_run(mask: ArrayLike) -> int:
    """Length of the longest run of consecutive True entries; 0 if there is none."""
    padded = np.concatenate([[0], np.asarray(mask, dtype=np.int8), [0]])
    starts = np.flatnonzero(np.diff(padded) == 1)
    ends = np.flatnonzero(np.diff(padded) == -1)
    return int((ends - starts).max(initial=0))


def elimination_rate(
    matrix: Array,
    sources: ArrayLike,
    *,
    theta: float,
    steps: Array | None = None,
    predicted: ArrayLike | None = None,
    form: Form = "corrected",
) -> Array:
    """Longest contiguous run of X_k, divided by N, for k = 1..K (method, section 4).

    Args:
        matrix: (N, N) performance, (source, target), contexts in order along one axis.
        sources: (K,) picked source indices in order.
        theta: slope of the linear gap, performance per grid step.
        steps: (N,) positions in grid steps; 0..N-1 when missing.
        predicted: (K,) Jhat(pi_xk, x_k) as the selector saw it; the training performance measured
            afterwards, J(pi_xk, x_k), when missing.
        form: see `search_space`.

    Returns:
        (K,) fractions in [0, 1]; the first is 1, for before any training every target may gain.

    Raises:
        InvalidInput: wrong shapes, or a source outside the matrix.
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    picks = np.asarray(sources, dtype=np.intp)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise InvalidInput(f"a transfer matrix must be (N, N), got shape {matrix.shape}")
    n = len(matrix)
    if picks.ndim != 1 or ((picks < 0) | (picks >= n)).any():
        raise InvalidInput(f"sources must be a list of indices from 0 to {n - 1}, got {sources!r}")
    position = np.arange(n, dtype=np.float64) if steps is None else np.asarray(steps, np.float64)
    if position.shape != (n,):
        raise InvalidInput(f"steps must have shape ({n},), got {position.shape}")
    guess = matrix[picks, picks] if predicted is None else np.asarray(predicted, np.float64)
    if guess.shape != picks.shape:
        raise InvalidInput(f"predicted must have shape {picks.shape}, got {guess.shape}")
    best = np.full(n, -np.inf)
    rates = np.empty(len(picks))
    for k, source in enumerate(picks):
        gap = theta * np.abs(position - position[source])
        rates[k] = longest_run(search_space(best, float(guess[k]), gap, form=form)) / n
        best = np.maximum(best, matrix[source])
    return rates


def sqrt_fractions(budget: int) -> Array:
    """(K,) |X_k| / |X| = 1 / sqrt(k) (paper, first corollary)."""
    return np.asarray(1.0 / np.sqrt(_picks(budget)))


def halving_fractions(budget: int) -> Array:
    """(K,) |X_k| / |X| = 2^-floor(log2 k), the rate of greedy gap splitting (second corollary)."""
    _, exponent = np.frexp(_picks(budget))  # exact where log2 could round up to the next power
    return np.asarray(np.exp2(1.0 - exponent))


def squared_sum(fractions: ArrayLike) -> Array:
    """(K,) running sums of (|X_k| / |X|)^2, the factor in `restricted_regret_bound`."""
    return np.cumsum(np.asarray(fractions, dtype=np.float64) ** 2)


def sqrt_sum_bound(budget: int, *, form: Form = "corrected") -> Array:
    """(K,) bound on `squared_sum(sqrt_fractions(K))`, which is the harmonic sum.

    corrected: 1 + log k. printed: log k, which the harmonic sum exceeds at every k (slip 3).
    """
    _check_form(form)
    return np.asarray(np.log(_picks(budget)) + (1.0 if form == "corrected" else 0.0))


def halving_sum_bound(budget: int, *, form: Form = "corrected") -> Array:
    """(K,) bound on `squared_sum(halving_fractions(K))`.

    corrected: 2, the limit. printed: pi^2 / 6, which fails from k = 6 (slip 4); the regret bound
    grows by sqrt(12 / pi^2) = 1.10.
    """
    _check_form(form)
    return np.full(len(_picks(budget)), 2.0 if form == "corrected" else np.pi**2 / 6.0)


def _picks(budget: int) -> Array:
    if budget < 1:
        raise InvalidInput(f"a budget is at least 1, got {budget}")
    return np.arange(1, budget + 1, dtype=np.float64)


def _check_form(form: str) -> None:
    if form not in get_args(Form):
        raise InvalidInput(f"form must be one of {get_args(Form)}, got {form!r}")
