"""Information gain: how much K noisy observations tell about a Gaussian process.

Notation (shapes): N contexts, K observations.
    kernel     (N, N)  prior covariance of training performance, performance squared
    noise_std  scalar  sigma, standard deviation of one observation, performance
    A                  a set of contexts, |A| = K
All logarithms are natural, so information is in nats.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import InvalidInput

_TIE = 1e-12


@dataclass(frozen=True)
class InformationGain:
    """The greedy sequence of most informative contexts, and what it says about gamma_K.

    Attributes:
        sources: (K,) context indices in greedy order.
        greedy: (K,) information gain of the first k of them: a lower bound of gamma_k.
    """

    sources: tuple[int, ...]
    greedy: Array

    @property
    def upper(self) -> Array:
        """(K,) upper bound of gamma_k: greedy / (1 - 1/e).

        Information gain is monotone and submodular, so the greedy value is at least that share of
        the maximum (Nemhauser, Wolsey and Fisher, 1978). The bounds on regret need this side.
        """
        return np.asarray(self.greedy / (1.0 - np.exp(-1.0)))


def information_gain(kernel: Array, *, noise_std: float) -> float:
    """Information in one observation of each context: 1/2 log det(I + sigma^-2 K_A).

    Args:
        kernel: (K, K) prior covariance of the observed contexts.
        noise_std: sigma > 0, performance.

    Returns:
        Nats; 0 for no observation.

    Raises:
        InvalidInput: the kernel is not square, or sigma is not positive.
    """
    kernel = _checked(kernel, noise_std)
    if len(kernel) == 0:
        return 0.0
    _, log_det = np.linalg.slogdet(np.eye(len(kernel)) + kernel / noise_std**2)
    return float(0.5 * log_det)


def maximum_information_gain(kernel: Array, budget: int, *, noise_std: float) -> InformationGain:
    """Greedy approximation of gamma_K = max over |A| = K of 1/2 log det(I + sigma^-2 K_A).

    Adding x to A gains 1/2 log(1 + s_A(x)^2 / sigma^2), where s_A is the posterior standard
    deviation, so the greedy choice is the context of largest posterior variance. The variance is
    updated by one pivoted Cholesky column per choice: O(N K^2) time, O(N K) memory.
    For the squared exponential gamma_K grows like (log K)^(d + 1) (the paper writes log K).

    Args:
        kernel: (N, N) prior covariance of all contexts.
        budget: K, from 1 to N; a context is chosen at most once, as a source is.
        noise_std: sigma > 0, performance.

    Raises:
        InvalidInput: the kernel is not square, sigma is not positive, or K is out of range.
    """
    kernel = _checked(kernel, noise_std)
    n = len(kernel)
    if not 1 <= budget <= n:
        raise InvalidInput(f"budget must be from 1 to the number of contexts ({n}), got {budget}")
    variance = np.diagonal(kernel).astype(np.float64).copy()
    factor = np.zeros((n, budget))
    chosen: list[int] = []
    gains = np.empty(budget)
    for k in range(budget):
        open_variance = variance.copy()
        open_variance[chosen] = -np.inf
        x = int(np.flatnonzero(open_variance >= open_variance.max() - _TIE)[0])
        at_x = max(float(variance[x]), 0.0)
        column = kernel[:, x] - factor[:, :k] @ factor[x, :k]
        factor[:, k] = column / np.sqrt(at_x + noise_std**2)
        variance -= factor[:, k] ** 2
        gains[k] = 0.5 * np.log1p(at_x / noise_std**2)
        chosen.append(x)
    return InformationGain(tuple(chosen), np.cumsum(gains))


def _checked(kernel: Array, noise_std: float) -> Array:
    kernel = np.asarray(kernel, dtype=np.float64)
    if kernel.ndim != 2 or kernel.shape[0] != kernel.shape[1]:
        raise InvalidInput(f"a kernel matrix must be square, got shape {kernel.shape}")
    if not (np.isfinite(noise_std) and noise_std > 0):
        raise InvalidInput(f"noise_std must be finite and > 0, got {noise_std!r}")
    return kernel
