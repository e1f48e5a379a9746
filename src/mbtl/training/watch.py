"""What happens while a model learns: progress reports and the best checkpoint."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from mbtl.trainer import OnProgress, Progress
from mbtl.training.export import export_mlp
from mbtl.training.rollout import Actor, Env, Job, play

REPORTS = 100
"""Progress reports per training."""


def actor_for(policy: Any) -> Actor:
    """Actor of a policy, on its numpy copy when there is one (about ten times as fast as torch)."""
    exported = export_mlp(policy) if hasattr(policy, "policy") else None
    return Actor(policy if exported is None else exported)


class BestCheckpoint:
    """Keeps the weights with the best mean return over fixed episodes on the model's own context.

    The episodes have their own environments and the same seeds at every checkpoint, so that weights
    are compared, not luck. Of equal checkpoints the earliest is kept, as in the reference protocol
    (cmdp-spec, section 3). Unchanged weights are not evaluated again.
    """

    def __init__(self, envs: Sequence[Env], seeds: Sequence[int], every: int) -> None:
        """`seeds`, one per episode, are dealt out over `envs`; `every` is in environment steps."""
        self._jobs = [Job(partial(_same, e), seeds[i :: len(envs)]) for i, e in enumerate(envs)]
        self._every, self._due = every, every
        self._updates: int | None = None
        self._weights: dict[str, Any] = {}
        self.latest: float | None = None
        self.best: float | None = None

    def visit(self, model: Any, *, last: bool = False) -> None:
        """Evaluate if a checkpoint is due (or this is the last) and the weights have changed."""
        if not last and model.num_timesteps < self._due:
            return
        self._due = model.num_timesteps + self._every
        if model._n_updates == self._updates:
            return
        self._updates = model._n_updates
        returns = play(self._jobs, actor_for(model), max_envs=len(self._jobs), keep_open=True)
        self.latest = float(np.concatenate(returns).mean())
        if self.best is None or self.latest > self.best:
            self.best = self.latest
            state = model.policy.state_dict()
            self._weights = {name: tensor.detach().clone() for name, tensor in state.items()}

    def restore(self, model: Any) -> None:
        """Put the best weights back."""
        if self._weights:
            model.policy.load_state_dict(self._weights)


class Watch:
    """Callback of one training, called after every environment step."""

    def __init__(
        self, model: Any, total: int, on_progress: OnProgress | None, best: BestCheckpoint | None
    ) -> None:
        self._model, self._total = model, total
        self._on_progress, self._best = on_progress, best
        self._interval = max(1, total // REPORTS)
        self._due = self._interval

    def __call__(self, _locals: dict[str, Any], _globals: dict[str, Any]) -> bool:
        """Form of a Stable-Baselines3 function callback; True: go on."""
        if self._best is not None:
            self._best.visit(self._model)
        if self._model.num_timesteps >= self._due:
            self._due = self._model.num_timesteps + self._interval
            self.report(min(self._model.num_timesteps, self._total))
        return True

    def report(self, step: int) -> None:
        """Tell the caller where the training stands."""
        if self._on_progress is None:
            return
        metrics: dict[str, float] = {}
        episodes = self._model.ep_info_buffer
        if episodes:
            metrics["episode_return"] = float(np.mean([episode["r"] for episode in episodes]))
        if self._best is not None and self._best.best is not None:
            metrics["checkpoint_return"] = float(self._best.latest or 0.0)
            metrics["best_return"] = self._best.best
        self._on_progress(Progress(step, self._total, metrics))


def _same(env: Env) -> Env:
    return env
