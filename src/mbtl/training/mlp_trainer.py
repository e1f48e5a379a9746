"""What trainers of many policies at once share: one policy is many of one."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.errors import InvalidInput, unknown_name
from mbtl.portfolio import MLPPolicy
from mbtl.trainer import OnProgress, checked_returns

_SAVE_SECONDS = 30.0


class MLPTrainer:
    """`mbtl.trainer.Trainer` in terms of `mbtl.trainer.ManyTrainer`; policies are plain arrays."""

    policy_format = "mlp"

    algorithm: str
    hyperparameters: Mapping[str, Any]
    """Fields of the recipe that differ from the named one."""
    checkpoint: str
    """The policy that `train` returns, "best" or "final"."""
    checkpoint_every: int | None

    @abstractmethod
    def train_many(
        self,
        contexts: Sequence[Context],
        seeds: Sequence[int],
        on_progress: OnProgress | None = None,
        *,
        keep: Sequence[str] = ("best", "final"),
        partial: Path | None = None,
    ) -> dict[str, list[MLPPolicy]]:
        """P policies for each name of `keep`; see `mbtl.trainer.ManyTrainer`."""

    @abstractmethod
    def evaluate_many(
        self, policies: Sequence[MLPPolicy], contexts: Sequence[Context], seed: int
    ) -> Array:
        """(P, n_targets, n_episodes) returns."""

    def train(
        self, context: Context, seed: int, on_progress: OnProgress | None = None
    ) -> MLPPolicy:
        """Train on one context; the same seed gives the same policy.

        Raises:
            TrainingFailed: the weights became NaN.
            InvalidInput: a hyper-parameter that the recipe does not have.
            MissingExtra: jax is not installed.
        """
        policies = self.train_many([context], [seed], on_progress, keep=(self.checkpoint,))
        return policies[self.checkpoint][0]

    def evaluate(self, policy: MLPPolicy, contexts: Sequence[Context], seed: int) -> Array:
        """Returns without adaptation, (n_targets, eval_episodes).

        Episode e starts from the same random numbers for every policy and every target.

        Args:
            policy: what `train` or `load` gave.
            contexts: the targets.
            seed: what `mbtl.seeds.evaluation_seed` gave.

        Raises:
            TrainingFailed: a return is NaN or infinite.
        """
        return checked_returns(self.evaluate_many([policy], contexts, seed)[0], len(contexts))

    def save(self, policy: MLPPolicy, folder: Path) -> bool:
        """Write weights and manifest into the empty `folder`."""
        policy.save(Path(folder))
        return True

    def load(self, folder: Path) -> MLPPolicy:
        """Read what `save` wrote; nothing but numbers is loaded."""
        return MLPPolicy.load(Path(folder))

    def _check(self, place: str, algorithms: Sequence[str], counts: Sequence[str]) -> None:
        """What every such trainer asks of its options; `counts` are fields that are >= 1."""
        if self.algorithm not in algorithms:
            raise unknown_name(f"algorithm of the {place}", self.algorithm, algorithms)
        for name in (*counts, *(["checkpoint_every"] if self.checkpoint_every else [])):
            number = getattr(self, name)
            if not (isinstance(number, int) and number >= 1):
                raise InvalidInput(f"{name} must be a whole number >= 1, got {number!r}")
        if self.checkpoint not in ("final", "best"):
            raise InvalidInput(f"checkpoint must be 'final' or 'best', got {self.checkpoint!r}")

    def _changed(self, named: Any) -> Any:
        """A named recipe with this trainer's `hyperparameters`."""
        known = named.record
        for name in self.hyperparameters:
            if name not in known:
                raise unknown_name(f"hyperparameter of {self.algorithm}", name, known)
        return replace(named, **self.hyperparameters)
