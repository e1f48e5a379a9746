"""One environment of the same interface for all contexts: every episode is in another of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gymnasium
import numpy as np

from mbtl.contexts import Context
from mbtl.errors import InvalidInput
from mbtl.faults import located

_SEEDS = 1 << 31


@dataclass(frozen=True)
class Everywhere:
    """A factory of environments whose resets draw a context uniformly, whatever it is given.

    Attributes:
        make_env: context -> Gymnasium environment or PettingZoo parallel environment.
        contexts: one or more to draw from; environments of all must have the same spaces.
    """

    make_env: Callable[[Context], Any]
    contexts: tuple[Context, ...]

    def __call__(self, _: Context) -> Any:
        """An environment for all contexts."""
        first = self.make_env(self.contexts[0])
        return (_Team if hasattr(first, "possible_agents") else _Single)(self, first)


class _Drawing:
    """What both interfaces share; `env` is the environment of the running episode."""

    env: Any

    def __init__(self, everywhere: Everywhere, first: Any) -> None:
        super().__init__(first)  # type: ignore[call-arg]  # of the interface
        self._make, self._contexts = everywhere.make_env, everywhere.contexts
        self._shown, self._context = _spaces(first), self._contexts[0]
        self._rng = np.random.default_rng()

    @cached_property
    def episode_steps(self) -> int:
        """Decisions of an episode in the mean over contexts, rounded up."""
        lengths = []
        for context in self._contexts:
            with closing(self._make(context)) as env:
                lengths.append(int(env.episode_steps))
        return math.ceil(np.mean(lengths))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Start an episode in the next context; a seed decides this one and all that follow."""
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        self._context = context = self._contexts[int(self._rng.integers(len(self._contexts)))]
        self.env.close()
        with located(context):
            self.env = self._make(context)
        if (there := _spaces(self.env)) != self._shown:
            raise InvalidInput(
                f"one policy for all contexts needs the same spaces in each, got {there} in "
                f"{dict(context)} beside {self._shown}; show the policy as many numbers in every "
                "context"
            )
        with located(context):
            return self.env.reset(seed=int(self._rng.integers(_SEEDS)), options=options)

    def step(self, action: Any) -> Any:
        """Of the running episode; a fault says in which context."""
        with located(self._context):
            return self.env.step(action)


class _Single(_Drawing, gymnasium.Wrapper):  # type: ignore[misc]  # gymnasium is untyped for our checker
    """All but `reset` and `step` is that of the environment."""


class _Forwarding:
    """A wrapper as Gymnasium's, for PettingZoo's parallel interface."""

    def __init__(self, env: Any) -> None:
        self.env = env

    def __getattr__(self, name: str) -> Any:
        if name == "env" or name.startswith("_"):  # in a copy that is not filled yet
            raise AttributeError(name)
        return getattr(self.env, name)


class _Team(_Drawing, _Forwarding):
    """All but `reset` is that of the team's environment."""


def _spaces(env: Any) -> tuple[Any, ...]:
    spaces = env.observation_space, env.action_space
    return tuple(space("") if callable(space) else space for space in spaces)
