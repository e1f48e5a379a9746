"""Multi-task training in any simulator: one environment whose context changes with every episode.

The baseline of cmdp-spec, 8.3: one policy, told the context, for all contexts. Any trainer that
takes an environment factory trains it unchanged; a traffic twin has its own way.

    trainer = SB3Trainer(make_env, algorithm="PPO", episodes=500)
    policy = for_all_contexts(trainer, space.contexts).train({}, seed=0)
    returns = trainer.evaluate(policy, space.contexts, seed=1)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mbtl.contexts import Context
from mbtl.envs.everywhere import multitask_env
from mbtl.trainer import OnProgress
from mbtl.training.sb3 import SB3Trainer
from mbtl.training.world_trainer import WorldTrainer


def train_on_all(
    trainer: SB3Trainer | WorldTrainer,
    contexts: Sequence[Context],
    seed: int,
    on_progress: OnProgress | None = None,
    *,
    partial: Path | None = None,
) -> Any:
    """One policy for all contexts, by either trainer.

    Args:
        trainer: of one source.
        contexts: of which one is drawn uniformly for every episode; for every update in a twin.
        seed: training seed.
        on_progress: told as by the trainer.
        partial: file of a twin's unfinished training; see `WorldTrainer.train_on_all`.

    Raises:
        InvalidInput: there are no contexts.
    """
    if isinstance(trainer, WorldTrainer):
        return trainer.train_on_all(contexts, seed, on_progress, partial=partial)
    return for_all_contexts(trainer, contexts).train(contexts[0], seed, on_progress)


def recipe_on_all(trainer: SB3Trainer | WorldTrainer) -> dict[str, Any]:
    """What decides the policy of `train_on_all` and its returns, JSON-able."""
    if isinstance(trainer, WorldTrainer):
        return trainer.recipe_on_all
    return {**trainer.recipe, "contexts": "uniform, one per episode"}


def for_all_contexts(trainer: SB3Trainer, contexts: Sequence[Context]) -> SB3Trainer:
    """The same trainer, whose every episode is in a context drawn uniformly from `contexts`.

    The context that its `train` is given is ignored.

    Raises:
        InvalidInput: there are no contexts.
    """
    return replace(trainer, make_env=_Everywhere(trainer.make_env, tuple(contexts)))


@dataclass(frozen=True)
class _Everywhere:
    """A factory that can be sent to other processes."""

    make_env: Callable[[Context], Any]
    contexts: tuple[Context, ...]

    def __call__(self, _: Context) -> Any:
        return multitask_env(self.make_env, self.contexts)
