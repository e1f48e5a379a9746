"""A model of Stable-Baselines3 as it acts in its environments.

The library counts choices from 0, and where observations are standardised it leaves that to the
environments it was trained in. Who uses a policy has neither in mind: so it brings both along.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import wraps
from typing import Any

import numpy as np

from mbtl.envs.adapter import Adapter
from mbtl.errors import InvalidInput
from mbtl.portfolio.mlp import BoxHead, DiscreteHead, MLPPolicy, Scaling


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics of observations as they were when a policy was made, of a `VecNormalize`.

    Attributes:
        rms: the library's running mean and variance; where observations have keys, by key.
        clip: largest absolute value of what is standardised.
        epsilon: added to the variance.
    """

    rms: Any
    clip: float
    epsilon: float

    def scaling(self, key: str = "") -> Scaling:
        """What they do to an observation."""
        rms = self.rms[key] if key else self.rms
        return Scaling(rms.mean, np.sqrt(rms.var + self.epsilon), self.clip)

    def __call__(self, seen: Any) -> Any:
        """(..., shape) observations, standardised."""
        if not isinstance(self.rms, dict):
            return self.scaling()(seen)
        return {k: self.scaling(k)(part) if k in self.rms else part for k, part in seen.items()}


@dataclass(eq=False)
class AdaptedPolicy:
    """A model, and what stands between it and its environments.

    Attributes:
        model: the library's.
        adapter: of its choices.
        statistics: of its observations; None: they are as they are.
    """

    model: Any
    adapter: Adapter = field(default_factory=Adapter)
    statistics: Statistics | None = None

    @property
    def predict(self) -> Callable[..., tuple[Any, Any]]:
        """The model's own with observations and actions of the environment, one or a batch.

        It takes what the model's takes, but is deterministic unless it is told otherwise.
        """

        @wraps(self.model.predict)
        def predict(observation: Any, *given: Any, **named: Any) -> tuple[Any, Any]:
            if len(given) < 3:  # state, episode_start, deterministic
                named.setdefault("deterministic", True)
            seen = self.adapter.observation(observation)
            if self.statistics is not None:
                seen = self.statistics(seen)
            action, state = self.model.predict(seen, *given, **named)
            return self.adapter.action(action), state

        return predict

    def exported(self, plain: MLPPolicy) -> MLPPolicy:
        """The same around a numpy copy of the model."""
        head: DiscreteHead | BoxHead = plain.head
        if isinstance(head, DiscreteHead) and self.adapter.acted_from is not None:
            start = np.atleast_1d(self.adapter.acted_from).tolist()
            head = replace(head, start=tuple(start))
        if isinstance(head, BoxHead):
            head = replace(head, whole=self.adapter.whole)
        scaling = None if self.statistics is None else self.statistics.scaling()
        return replace(plain, head=head, scaling=scaling)


def adapted(model: Any) -> Any:
    """A model that still has its environments, as it acts in them; itself where nothing differs."""
    envs, normalize = model.env, model.get_vec_normalize_env()
    adapter = Adapter() if hasattr(envs, "slots") else envs.get_attr("adapter", [0])[0]
    statistics = None
    if normalize is not None and normalize.norm_obs:
        rms, clip = deepcopy(normalize.obs_rms), float(normalize.clip_obs)
        statistics = Statistics(rms, clip, float(normalize.epsilon))
    return around(model, adapter, statistics)


def around(model: Any, adapter: Adapter, statistics: Statistics | None) -> Any:
    """A model with its adapter and statistics; itself where it has none."""
    if not adapter.changes and statistics is None:
        return model
    return AdaptedPolicy(model, adapter, statistics)


def model_of(policy: Any) -> Any:
    """The library's model in a policy of its trainer."""
    return policy.model if isinstance(policy, AdaptedPolicy) else policy


def begin_statistics(model: Any, statistics: Statistics | None) -> None:
    """Let the environments of a model standardise as those of another policy did.

    Raises:
        InvalidInput: only one of both standardises.
    """
    own = model.get_vec_normalize_env()
    running, begun = own is not None and own.norm_obs, statistics is not None
    if running != begun:
        raise InvalidInput(
            "a policy that learnt from standardised observations goes on with them, and no other, "
            f"got normalize_observations={running} and a policy trained with {begun}; use the "
            "trainer that made it"
        )
    if statistics is not None:
        own.obs_rms = deepcopy(statistics.rms)
