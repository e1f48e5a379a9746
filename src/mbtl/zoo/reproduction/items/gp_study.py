"""Item 13: how the paper chose its Gaussian process: noise, restarts and kernels on synthetic data.

The data are the paper's: training performance is the same everywhere, the gap is linear, and every
transferred performance loses up to a tenth of itself. The process is fitted, as in the released
code, to the best performance seen at each context trained on, and predicts it everywhere else.
"""

from __future__ import annotations

import itertools
import warnings
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace, Linear
from mbtl.models.gp import GPSettings
from mbtl.plot.style import new_figure
from mbtl.selectors import get_selector
from mbtl.selectors.base import SelectionProblem
from mbtl.zoo.benchmark.replay import replay
from mbtl.zoo.reproduction.bench import Bench
from mbtl.zoo.reproduction.item import Item, Numbers, Table

NOISES = (0.001, 0.01, 0.1, 1.0)
RESTARTS = (5, 10, 15)
KERNELS = ("RBF", "Matern 3/2", "Matern 5/2", "rational quadratic")
_N, _THETA, _LOSS, _WORLDS = 100, 0.005, 0.1, 3
_TRAININGS = (5, 15)


def compute(bench: Bench) -> Numbers:
    """Root mean squared error of the prediction, mean over worlds and numbers of trainings."""
    worlds = [_world(np.random.default_rng(seed)) for seed in range(_WORLDS)]
    rows = []
    for kernel, noise, restarts in itertools.product(KERNELS, NOISES, RESTARTS):
        bench.says(f"fitting {kernel}, noise {noise:g}, {restarts} restarts")
        errors = [_error(world, k, kernel, noise, restarts) for world in worlds for k in _TRAININGS]
        rows.append(
            {"kernel": kernel, "noise": noise, "restarts": restarts, "rmse": float(np.mean(errors))}
        )
    return {"rows": rows, "missing": []}


def _world(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Points and values that training showed along gap splitting, and the truth everywhere."""
    steps = np.arange(_N, dtype=np.float64)
    rows = 1.0 - _THETA * np.abs(steps[:, None] - steps)
    rows *= 1.0 - rng.uniform(0.0, _LOSS, rows.shape)
    problem = SelectionProblem.of(
        ContextSpace.grid({Linear("x", 0.0, _N - 1.0): _N}), budget=max(_TRAININGS), theta=_THETA
    )
    picks = replay(get_selector("greedy"), problem, lambda i: rows[i]).history.sources
    best = np.maximum.accumulate(rows[list(picks)], axis=0)
    seen = best[np.arange(len(picks)), list(picks)]
    return np.array(picks, dtype=np.float64), seen, np.ones(_N)


def _error(
    world: tuple[Array, Array, Array], k: int, kernel: str, noise: float, restarts: int
) -> float:
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor

    points, seen, truth = world
    regressor = GaussianProcessRegressor(
        _kernel(kernel), alpha=noise**2, n_restarts_optimizer=restarts, random_state=0
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # an optimum on a bound is allowed
        regressor.fit(points[:k, None], seen[:k])
    believed = regressor.predict(np.arange(_N, dtype=np.float64)[:, None])
    return float(np.sqrt(np.mean((believed - truth) ** 2)))


def _kernel(name: str) -> Any:
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, RationalQuadratic

    bounds = GPSettings()
    shapes = {
        "RBF": lambda: RBF(1.0, bounds.length_bounds),
        "Matern 3/2": lambda: Matern(1.0, bounds.length_bounds, nu=1.5),
        "Matern 5/2": lambda: Matern(1.0, bounds.length_bounds, nu=2.5),
        "rational quadratic": lambda: RationalQuadratic(
            1.0, 1.0, bounds.length_bounds, bounds.length_bounds
        ),
    }
    return ConstantKernel(1.0, bounds.amplitude_bounds) * shapes[name]()


def tables(numbers: Numbers) -> dict[str, Table]:
    """A line per combination, the best first."""
    ordered = sorted(numbers["rows"], key=lambda row: row["rmse"])
    rows = tuple(
        (row["kernel"], f"{row['noise']:g}", row["restarts"], row["rmse"]) for row in ordered
    )
    return {
        "": Table(
            "Gaussian processes on synthetic data: root mean squared error of the predicted "
            "training performance.",
            ("kernel", "noise std", "restarts", "error"),
            rows,
            ("The paper chose RBF, noise 0.001 and 15 restarts.",),
        )
    }


def figures(numbers: Numbers) -> dict[str, Any]:
    """Error against noise, a line per kernel, for the most restarts."""
    figure = new_figure(4.2, 2.8)
    ax = figure.subplots()
    most = max(row["restarts"] for row in numbers["rows"])
    for kernel, mark in zip(KERNELS, "osD^", strict=True):
        some = [r for r in numbers["rows"] if r["kernel"] == kernel and r["restarts"] == most]
        ax.plot([r["noise"] for r in some], [r["rmse"] for r in some], f"{mark}-", ms=4,
                label=kernel)  # fmt: skip
    ax.set_xscale("log")
    ax.set_xlabel("noise std")
    ax.set_ylabel("error of the prediction")
    ax.set_title(f"{most} restarts")
    ax.legend(loc="best")
    return {"": figure}


ITEM = Item(13, "gp-study", "The choice of the Gaussian process", compute, tables, figures,
            prefixes=("no CMDP",))  # fmt: skip
