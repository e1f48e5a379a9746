"""One environment of the same interface for all contexts: every episode is in another of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from mbtl.contexts import Context
from mbtl.errors import InvalidInput

_SEEDS = 1 << 31


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
class Everywhere:
    """`multitask_env` as a factory that can be sent to other processes, whatever it is given."""

    make_env: Callable[[Context], Any]
    contexts: tuple[Context, ...]

    def __call__(self, _: Context) -> Any:
        """An environment for all contexts."""
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
