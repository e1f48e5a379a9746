"""Multi-task training in any simulator: one environment whose context changes with every episode.

The baseline of cmdp-spec, 8.3: one policy, told the context, for all contexts. Any trainer that
takes an environment factory trains it unchanged; a traffic twin has its own way.

    trainer = SB3Trainer(make_env, algorithm="PPO", episodes=500)
    policy = for_all_contexts(trainer, space.contexts).train({}, seed=0)
    returns = trainer.evaluate(policy, space.contexts, seed=1)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from mbtl.contexts import Context
from mbtl.errors import InvalidInput
from mbtl.trainer import OnProgress
from mbtl.training.sb3 import SB3Trainer
from mbtl.training.world_trainer import WorldTrainer

_SEEDS = 1 << 31


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


def multitask_env(make_env: Callable[[Context], Any], contexts: Sequence[Context]) -> Any:
    """An environment of the same interface whose resets draw a context uniformly.

    Args:
        make_env: context -> Gymnasium environment or PettingZoo parallel environment.
        contexts: from which to draw; environments of all must have the same spaces.

    Raises:
        InvalidInput: there are no contexts.
    """
    if not contexts:
        raise InvalidInput("multi-task training takes at least one context, got none")
    first = make_env(contexts[0])
    kind = _Team if hasattr(first, "possible_agents") else _Single
    return kind(make_env, contexts, first)


@dataclass(frozen=True)
class _Everywhere:
    """A factory that can be sent to other processes."""

    make_env: Callable[[Context], Any]
    contexts: tuple[Context, ...]

    def __call__(self, _: Context) -> Any:
        return multitask_env(self.make_env, self.contexts)


class _AnyContext:
    """What both interfaces share; `current` is the environment of the running episode."""

    def __init__(
        self, make_env: Callable[[Context], Any], contexts: Sequence[Context], first: Any
    ) -> None:
        self._make, self._contexts = make_env, contexts
        self.current = first
        self._rng = np.random.default_rng()
        self._episode_steps: int | None = None

    @property
    def episode_steps(self) -> int:
        """Decisions of an episode in the mean over contexts, rounded up."""
        if self._episode_steps is None:
            lengths = []
            for context in self._contexts:
                env = self._make(context)
                lengths.append(int(env.episode_steps))
                env.close()
            self._episode_steps = math.ceil(np.mean(lengths))
        return self._episode_steps

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Start an episode in the next context; a seed decides this one and all that follow."""
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        context = self._contexts[int(self._rng.integers(len(self._contexts)))]
        self.current.close()
        self.current = self._make(context)
        self._check(context)
        return self.current.reset(seed=int(self._rng.integers(_SEEDS)), options=options)

    def step(self, action: Any) -> Any:
        """Of the environment of this episode."""
        return self.current.step(action)

    def render(self) -> Any:
        """Of the environment of this episode."""
        return self.current.render()

    def close(self) -> None:
        """End the environment of this episode."""
        self.current.close()

    def _check(self, context: Context) -> None:
        here, there = self._spaces(self), self._spaces(self.current)
        if here != there:
            raise InvalidInput(
                f"one policy for all contexts needs the same spaces in each, got {there} in "
                f"{dict(context)} beside {here}; show the policy as many numbers in every context"
            )

    def _spaces(self, env: Any) -> Any:
        raise NotImplementedError


class _Single(_AnyContext, gymnasium.Env):  # type: ignore[misc]  # gymnasium is untyped for our checker
    def __init__(self, make_env: Any, contexts: Any, first: Any) -> None:
        super().__init__(make_env, contexts, first)
        self.observation_space, self.action_space = self._spaces(first)
        self.metadata, self.render_mode = first.metadata, first.render_mode

    def _spaces(self, env: Any) -> Any:
        return env.observation_space, env.action_space


class _Team(_AnyContext):
    def __init__(self, make_env: Any, contexts: Any, first: Any) -> None:
        super().__init__(make_env, contexts, first)
        self._observation_space, self._action_space = self._spaces(first)
        self.most_agents: int = first.most_agents

    @property
    def agents(self) -> list[str]:
        agents: list[str] = self.current.agents
        return agents

    @property
    def possible_agents(self) -> list[str]:
        agents: list[str] = self.current.possible_agents
        return agents

    def observation_space(self, agent: str) -> Any:
        return self._observation_space

    def action_space(self, agent: str) -> Any:
        return self._action_space

    def _spaces(self, env: Any) -> Any:
        return env.observation_space(""), env.action_space("")
