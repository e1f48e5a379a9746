"""The GP with learned mean and noise: at a maximum of its likelihood, and calm on wild data."""

from types import SimpleNamespace

import numpy as np
import pytest

from mbtl.models import GPSettings
from mbtl.models.constant_mean_gp import fit_constant_mean

WIDE = GPSettings(noise_std=1e-2, amplitude_bounds=(1e-9, 1e3))


def direct_likelihood(x, y, gp):
    """Log density of y under the fitted process, mean included, by its covariance matrix."""
    squared = ((x[:, None] - x) ** 2).sum(axis=2)
    covariance = gp.amplitude * np.exp(-0.5 * squared / gp.length**2)
    covariance += gp.noise_variance * np.eye(len(y))
    rest = y - gp.mean
    quadratic = rest @ np.linalg.solve(covariance, rest)
    return -0.5 * (quadratic + np.linalg.slogdet(covariance)[1] + len(y) * np.log(2 * np.pi))


def test_constant_mean_gp_is_at_a_maximum_of_its_likelihood():
    rng = np.random.default_rng(1)
    x = rng.uniform(0, 10, (30, 2))
    y = 0.6 + 0.1 * np.sin(x[:, 0] / 2) + 0.03 * rng.standard_normal(30)
    gp = fit_constant_mean(x, y, WIDE)
    top = direct_likelihood(x, y, gp)
    assert gp.lml == pytest.approx(top)
    for change in (0.9, 1.1):
        for name in ("amplitude", "length", "noise_variance", "mean"):
            values = {**vars(gp), name: getattr(gp, name) * change}
            assert direct_likelihood(x, y, SimpleNamespace(**values)) < top


@pytest.mark.parametrize("y", [[0.5], [0.5, 0.5], [0.5, 0.9], [-1e6, -1e6, -1e6], [0.2, -1e6, 0.3]])
def test_gp_of_few_or_wild_values_still_predicts_between_them(y):
    x = np.arange(len(y), dtype=float)[:, None] * 3
    gp = fit_constant_mean(x, y, WIDE)
    mean, std = gp.predict(np.linspace(-5, 20, 30)[:, None])
    assert gp.noise_variance >= WIDE.noise_std**2 * (1 - 1e-9)
    assert np.isfinite(mean).all()
    assert np.isfinite(std).all()
    slack = 1e-6 * max(map(abs, y))
    assert min(y) - slack <= gp.mean <= max(y) + slack
