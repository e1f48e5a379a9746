"""The peers that one pick is timed against, each with the same observations and its usual settings.

The Bayesian optimisers know nothing of transfer: they model the training performance and maximise a
standard acquisition over N candidates. That is less work than a pick of `mbtl`, whose acquisition
also sums over N targets.
"""

from __future__ import annotations

import math
import warnings
from typing import Any, Protocol

from mbtl.errors import missing_extra


class Rival(Protocol):
    """Learns one observation at a time and proposes the next of N contexts on one axis."""

    name: str

    def observe(self, source: int, performance: float) -> None:
        """Add the training performance of one source."""
        ...

    def ask(self) -> int:
        """The next source: what is timed."""
        ...


class OptunaGP:
    """Optuna's GPSampler over one integer: its default settings, without random start-up trials."""

    name = "Optuna GPSampler, ask"

    def __init__(self, n_contexts: int) -> None:
        try:
            import optuna
            import torch
        except ImportError as error:
            raise missing_extra("optuna with torch", "rivals") from error
        torch.set_num_threads(1)
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._optuna = optuna
        self._axis = {"context": optuna.distributions.IntDistribution(0, n_contexts - 1)}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Optuna marks the sampler as experimental
            sampler = optuna.samplers.GPSampler(seed=0, n_startup_trials=1)
        self._study = optuna.create_study(direction="maximize", sampler=sampler)
        self._asked: Any = None

    def observe(self, source: int, performance: float) -> None:
        """Add a finished trial; one study is kept, so that the sampler's warm start helps it."""
        if self._asked is not None:
            self._study.tell(self._asked, state=self._optuna.trial.TrialState.FAIL)
            self._asked = None
        trial = self._optuna.trial.create_trial(
            params={"context": source}, distributions=self._axis, value=performance
        )
        self._study.add_trial(trial)

    def ask(self) -> int:
        """Fit and optimise, as `study.ask` does."""
        self._asked = self._study.ask(self._axis)
        return int(self._asked.params["context"])


class BoTorchDiscrete:
    """BoTorch: `SingleTaskGP` fit, then `optimize_acqf_discrete` of the UCB over all candidates."""

    name = "BoTorch SingleTaskGP + optimize_acqf_discrete"

    def __init__(self, n_contexts: int) -> None:
        try:
            import botorch  # noqa: F401  # imported here, so that no pick pays for it
            import torch
        except ImportError as error:
            raise missing_extra("botorch", "rivals") from error
        torch.set_num_threads(1)
        self._torch = torch
        self._choices = torch.linspace(0.0, 1.0, n_contexts, dtype=torch.float64)[:, None]
        self._sources: list[int] = []
        self._performances: list[float] = []

    def observe(self, source: int, performance: float) -> None:
        """Keep the observation; the model is fitted anew at each ask, as BoTorch's tutorials do."""
        self._sources.append(source)
        self._performances.append(performance)

    def ask(self) -> int:
        """Fit, then the best candidate that was not observed; beta_k is that of `mbtl`."""
        from botorch.acquisition import UpperConfidenceBound
        from botorch.fit import fit_gpytorch_mll
        from botorch.models import SingleTaskGP
        from botorch.optim import optimize_acqf_discrete
        from gpytorch.mlls import ExactMarginalLogLikelihood

        n, k = len(self._choices), len(self._sources) + 1
        seen = self._choices[self._sources]
        y = self._torch.tensor(self._performances, dtype=self._torch.float64)[:, None]
        model = SingleTaskGP(seen, y)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of fits that need a second try
            fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
            rule = UpperConfidenceBound(model, beta=2.0 * math.log(n * k**2))
            found, _ = optimize_acqf_discrete(rule, q=1, choices=self._choices, X_avoid=seen)
        return round(float(found) * (n - 1))


RIVALS: tuple[type[OptunaGP] | type[BoTorchDiscrete], ...] = (OptunaGP, BoTorchDiscrete)
