"""A model of Stable-Baselines3 as it acts in its environments.

The library counts choices from 0, and where observations are standardised it leaves that to the
environments it was trained in. Who uses a policy has neither in mind: so it brings both along.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mbtl.envs.adapter import Adapter
from mbtl.errors import InvalidInput
from mbtl.portfolio.mlp import BoxHead, DiscreteHead, MLPPolicy, Scaling


@dataclass(frozen=True)
class Statistics:
    """Running mean and variance of one array of observations, as they are now.

    Attributes:
        mean: as long as an observation has numbers.
        var: likewise.
        count: observations they were learnt from.
        clip: largest absolute value of what is standardised.
        epsilon: added to the variance.
    """

    mean: Any
    var: Any
    count: float
    clip: float
    epsilon: float

    @property
    def scaling(self) -> Scaling:
        """What they do to an observation; as the library's `VecNormalize` does it."""
        return Scaling(self.mean, np.sqrt(self.var + self.epsilon), self.clip)


@dataclass(eq=False)
class AdaptedPolicy:
    """A model, and what stands between it and its environments.

    Attributes:
        model: the library's.
        adapter: of its choices.
        statistics: of its observations, by key; "" where there are no keys; none: as they are.
    """

    model: Any
    adapter: Adapter = field(default_factory=Adapter)
    statistics: Mapping[str, Statistics] = field(default_factory=dict)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Actions of the environment for one of its observations or a batch, as the model's."""
        return self._predict(
            observation, state=state, episode_start=episode_start, deterministic=deterministic
        )

    def exported(self, plain: MLPPolicy) -> MLPPolicy:
        """The same around a numpy copy of the model."""
        head: DiscreteHead | BoxHead = plain.head
        if isinstance(head, DiscreteHead) and self.adapter.acted_from is not None:
            start = np.atleast_1d(self.adapter.acted_from).tolist()
            head = replace(head, start=tuple(start))
        if isinstance(head, BoxHead):
            head = replace(head, whole=self.adapter.whole)
        known = self.statistics.get("")
        return replace(plain, head=head, scaling=None if known is None else known.scaling)

    def record(self) -> dict[str, Any]:
        """JSON-able, to the last bit."""
        return {
            "observed_from": dict(self.adapter.observed_from),
            "acted_from": self.adapter.acted_from,
            "whole": self.adapter.whole,
            "statistics": {
                key: {**vars(one), "mean": one.mean.tolist(), "var": one.var.tolist()}
                for key, one in self.statistics.items()
            },
        }

    def _predict(self, observation: Any, **given: Any) -> tuple[Any, Any]:
        seen = self.adapter.observation(observation)
        if "" in self.statistics:
            seen = self.statistics[""].scaling(seen)
        elif self.statistics:
            known = self.statistics
            seen = {k: known[k].scaling(v) if k in known else v for k, v in seen.items()}
        action, state = self.model.predict(seen, **given)
        return self.adapter.action(action), state


class MaskedPolicy(AdaptedPolicy):
    """Of a model that takes masks of actions."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
        action_masks: Any = None,
    ) -> tuple[Any, Any]:
        """As of `AdaptedPolicy`; masks are those of the environment."""
        return self._predict(
            observation,
            state=state,
            episode_start=episode_start,
            deterministic=deterministic,
            action_masks=action_masks,
        )


def adapted(model: Any) -> Any:
    """A model that still has its environments, as it acts in them; itself where nothing differs."""
    envs, normalize = model.env, model.get_vec_normalize_env()
    adapter = Adapter() if hasattr(envs, "slots") else envs.get_attr("adapter", [0])[0]
    statistics: dict[str, Statistics] = {}
    if normalize is not None and normalize.norm_obs:
        found = normalize.obs_rms
        found = found if isinstance(found, dict) else {"": found}
        statistics = {
            key: Statistics(
                np.array(one.mean), np.array(one.var), float(one.count),
                float(normalize.clip_obs), float(normalize.epsilon),
            )
            for key, one in found.items()
        }  # fmt: skip
    return around(model, adapter, statistics)


def around(model: Any, adapter: Adapter, statistics: Mapping[str, Statistics]) -> Any:
    """A model with its adapter and statistics; itself where it has none."""
    if not adapter.changes and not statistics:
        return model
    kind = MaskedPolicy if type(model).__name__.startswith("Maskable") else AdaptedPolicy
    return kind(model, adapter, statistics)


def read_adapted(model: Any, record: Mapping[str, Any] | None) -> Any:
    """What `AdaptedPolicy.record` gave, around a model; the model itself for None."""
    if record is None:
        return model
    adapter = Adapter(record["observed_from"], record["acted_from"], record["whole"])
    statistics = {
        key: Statistics(**{**one, "mean": np.array(one["mean"]), "var": np.array(one["var"])})
        for key, one in record["statistics"].items()
    }
    return around(model, adapter, statistics)


def model_of(policy: Any) -> Any:
    """The library's model in a policy of its trainer."""
    return policy.model if isinstance(policy, AdaptedPolicy) else policy


def begin_statistics(model: Any, statistics: Mapping[str, Statistics]) -> None:
    """Let the environments of a model standardise as those of another policy did.

    Raises:
        InvalidInput: only one of both standardises.
    """
    normalize = model.get_vec_normalize_env()
    running = normalize is not None and normalize.norm_obs
    if running != bool(statistics):
        raise InvalidInput(
            "a policy that learnt from standardised observations goes on with them, and no other, "
            f"got normalize_observations={running} and a policy trained with {bool(statistics)}; "
            "use the trainer that made it"
        )
    for key, one in statistics.items():
        running_one = normalize.obs_rms[key] if key else normalize.obs_rms
        running_one.mean, running_one.var = one.mean.copy(), one.var.copy()
        running_one.count = one.count
