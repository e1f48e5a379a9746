"""Regret bounds of MBTL and the exploration schedules they rest on (paper, section 4).

Notation: N contexts, K trainings, all curves are given at k = 1..K.
    beta   (K,)  exploration weight beta_k, dimensionless
    gamma  (K,)  maximum information gain of k observations, nats; use `InformationGain.upper`
    R_K          cumulative regret, performance
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.errors import InvalidInput


def beta_experiments(k: ArrayLike, n: int) -> Array:
    """Exploration weight of the experiments: beta_k = 2 log(N k^2).

    Args:
        k: 1-based number of the pick, any shape.
        n: number of contexts N.
    """
    k = _checked_picks(k, n)
    return np.asarray(2.0 * np.log(n * k**2))


def beta_theory(k: ArrayLike, n: int, delta: float) -> Array:
    """Exploration weight of the theorem: beta_k = 2 log(N pi^2 k^2 / (6 delta)).

    Args:
        k: 1-based number of the pick, any shape.
        n: number of contexts N.
        delta: probability that the bound fails, in (0, 1).

    Raises:
        InvalidInput: `delta` is outside (0, 1), or k or N is below 1.
    """
    k = _checked_picks(k, n)
    if not 0.0 < delta < 1.0:
        raise InvalidInput(f"delta is a probability in (0, 1), got {delta!r}")
    return np.asarray(2.0 * np.log(n * np.pi**2 * k**2 / (6.0 * delta)))


def confidence_constant(noise_std: float, *, prior_variance: float = 1.0) -> float:
    """The constant C1 = 8 / log(1 + sigma^-2) of the regret bound.

    That form holds for a kernel with k(x, x) <= 1. For k(x, x) <= v the same proof gives
    C1 = 8 v / log(1 + v sigma^-2).

    Args:
        noise_std: sigma > 0, performance.
        prior_variance: v > 0, performance squared.
    """
    for label, number in (("noise_std", noise_std), ("prior_variance", prior_variance)):
        if not (np.isfinite(number) and number > 0):
            raise InvalidInput(f"{label} must be finite and > 0, got {number!r}")
    return float(8.0 * prior_variance / np.log1p(prior_variance / noise_std**2))


def regret_bound(
    beta: ArrayLike, gamma: ArrayLike, *, noise_std: float, prior_variance: float = 1.0
) -> Array:
    """Bound on cumulative regret: R_k <= sqrt(k C1 beta_k gamma_k) (paper, theorem 1).

    Holds with probability 1 - delta when beta is `beta_theory` of that delta, training performance
    is a draw from the process, and the gap is the modelled one.

    Args:
        beta: (K,) exploration weights.
        gamma: (K,) upper bounds of the maximum information gain.
        noise_std: see `confidence_constant`.
        prior_variance: see `confidence_constant`.

    Returns:
        (K,) bounds, performance.
    """
    n_picks = len(np.atleast_1d(np.asarray(gamma)))
    ones = np.ones(n_picks)
    return restricted_regret_bound(
        beta, gamma, ones, noise_std=noise_std, prior_variance=prior_variance
    )


def restricted_regret_bound(
    beta: ArrayLike,
    gamma: ArrayLike,
    fractions: ArrayLike,
    *,
    noise_std: float,
    prior_variance: float = 1.0,
) -> Array:
    """Bound on a restricted search: R_k <= sqrt(C1 beta_k gamma_k sum_{i<=k} (|X_i|/|X|)^2).

    Only targets in the search space X_i can gain, hence r_i <= (|X_i|/|X|) s_i with
    sum s_i^2 <= C1 beta_k gamma_k; the bound is Cauchy-Schwarz on the sum of these products. The
    printed proof writes r_i where this step needs r_i^2 (slip 2); the statement is right.

    Args:
        beta: (K,) exploration weights.
        gamma: (K,) upper bounds of the maximum information gain.
        fractions: (K,) |X_i| / |X| in [0, 1]: `elimination_rate`, `sqrt_fractions`, ...
        noise_std: see `confidence_constant`.
        prior_variance: see `confidence_constant`.

    Returns:
        (K,) bounds, performance.

    Raises:
        InvalidInput: the three curves differ in length, or a fraction is outside [0, 1].
    """
    b, g, f = (np.atleast_1d(np.asarray(a, dtype=np.float64)) for a in (beta, gamma, fractions))
    if not (b.shape == g.shape == f.shape and b.ndim == 1):
        raise InvalidInput(
            f"beta, gamma and fractions must be curves of one length, got shapes {b.shape}, "
            f"{g.shape} and {f.shape}"
        )
    if not ((f >= 0) & (f <= 1)).all():
        raise InvalidInput(f"fractions |X_k|/|X| lie in [0, 1], got {f.min()} to {f.max()}")
    c1 = confidence_constant(noise_std, prior_variance=prior_variance)
    return np.asarray(np.sqrt(c1 * b * g * np.cumsum(f**2)))


def _checked_picks(k: ArrayLike, n: int) -> Array:
    picks = np.asarray(k, dtype=np.float64)
    if n < 1 or (picks < 1).any():
        raise InvalidInput(f"picks k count from 1 and N is at least 1, got k = {k!r} and N = {n}")
    return picks
