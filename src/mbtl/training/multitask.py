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
from typing import TYPE_CHECKING, Any

from mbtl.contexts import Context
from mbtl.envs.everywhere import multitask_env

if TYPE_CHECKING:
    from mbtl.training.sb3 import SB3Trainer


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
