"""The paper's own GP, scikit-learn with random restarts: what `fit_gp` is held against."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike

from mbtl.models.gp import FittedGP, GPSettings, checked_data


def fit_sklearn(
    points: ArrayLike,
    y: ArrayLike,
    settings: GPSettings | None = None,
    *,
    restarts: int = 15,
    seed: int = 0,
) -> FittedGP:
    """Fit by `GaussianProcessRegressor`: Constant x RBF with fixed noise.

    L-BFGS climbs the likelihood from 1 + `restarts` starts.

    Args:
        points: (n, D) or (n,) locations in grid steps.
        y: (n,) training performances, not centred.
        settings: bounds and noise; defaults are the paper's.
        restarts: random restarts of the optimiser (paper: 15; released code: 9).
        seed: of the restarts.
    """
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel

    settings = settings or GPSettings()
    x, target = checked_data(points, y)
    kernel = ConstantKernel(1.0, settings.amplitude_bounds) * RBF(1.0, settings.length_bounds)
    regressor = GaussianProcessRegressor(
        kernel, alpha=settings.noise_std**2, n_restarts_optimizer=restarts, random_state=seed
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # an optimum on a bound is allowed
        regressor.fit(x, target)
    amplitude, length = np.exp(regressor.kernel_.theta)
    return FittedGP(x, target, float(amplitude), float(length), settings.noise_std**2)
