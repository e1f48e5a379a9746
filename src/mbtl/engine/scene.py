"""One environment as a scene, for a process of its own: its agents have places.

It is a Gymnasium environment, whose agent has the only place, or a PettingZoo parallel one, whose
agents come and go. What an episode is worth is as in `mbtl.envs.rollout`.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.contexts import Context
from mbtl.envs.slots import seated
from mbtl.score import Score

Sight = tuple[NDArray[np.float32], NDArray[np.bool_], bool, float]
"""A scene between two decisions: (A, f) observations, of places without an agent any; (A,) there is
an agent, and it decides; whether the episode has ended; and what it is worth, once it has. An agent
that decides at the end was cut off: its life had not ended."""

_ALONE = "alone"
"""The agent of a Gymnasium environment."""


class EnvScene:
    """The environments of one factory, one at a time."""

    def __init__(
        self, make_env: Callable[[Context], Any], places: int, score: Score | None = None
    ) -> None:
        """Nothing is made yet.

        Args:
            make_env: context -> environment.
            places: for agents; 1 of a Gymnasium environment.
            score: what an episode is worth; None: the sum of its rewards.
        """
        self._make, self._places, self._score = make_env, places, score
        self._context: dict[str, float] | None = None
        self._env: Any = None

    def start(self, context: Mapping[str, float], seed: int) -> Sight:
        """Begin an episode; an environment serves until another context is asked for."""
        if self._context != context:
            if self._env is not None:
                self._env.close()
            self._env, self._context = self._make(dict(context)), dict(context)
        self._present: list[str | None] = [None] * self._places
        self._total = 0.0
        seen, _ = self._env.reset(seed=seed)
        if not self._is_team:
            return self._seen({_ALONE: seen}, [_ALONE], 0.0)
        told = not self._env.agents and self._score is not None  # nobody ever has to decide
        return self._seen(seen, self._env.agents, self._worth(self._env.summary) if told else 0.0)

    def step(
        self, action: NDArray[Any] | None
    ) -> tuple[Sight, NDArray[np.float32], NDArray[np.bool_]]:
        """One decision of all agents, (A,) or (A, d); None: nobody is told anything.

        Returns:
            What is seen then, (A,) rewards, and whose life has ended.
        """
        places = {agent: k for k, agent in enumerate(self._present) if agent is not None}
        told = {} if action is None else {agent: action[k] for agent, k in places.items()}
        (seen, rewards, terminated, truncated, infos), agents = self._moved(told)
        reward, done = np.zeros(self._places, np.float32), np.zeros(self._places, np.bool_)
        for agent, k in places.items():
            reward[k] = rewards[agent]
            done[k] = terminated[agent]
            if done[k] or (agent not in agents and not truncated[agent]):
                self._present[k] = None
        self._total += float(reward.sum())
        info: Mapping[str, Any] = next(iter(infos.values()), {})
        return self._seen(seen, agents, 0.0 if agents else self._worth(info)), reward, done

    # ---- inside ------------------------------------------------------------------------------

    @property
    def _is_team(self) -> bool:
        return hasattr(self._env, "possible_agents")

    def _moved(self, told: Mapping[str, Any]) -> tuple[Any, list[str]]:
        """What a step gives by agent, and the agents that are there then."""
        if self._is_team:
            return self._env.step(told), self._env.agents
        moved = self._env.step(told[_ALONE]) if told else self._env.drive()
        _, _, terminated, truncated, _ = moved
        return [{_ALONE: x} for x in moved], [] if terminated or truncated else [_ALONE]

    def _worth(self, info: Mapping[str, Any]) -> float:
        return self._total if self._score is None else self._score.read(info)

    def _seen(self, seen: Mapping[str, Any], agents: Sequence[str], score: float) -> Sight:
        seated(self._present, agents)
        space = self._env.observation_space
        shape = (space("") if self._is_team else space).shape
        obs = np.zeros((self._places, *shape), np.float32)
        for k, agent in enumerate(self._present):
            if agent is not None:
                obs[k] = seen[agent]
        acting = np.array([agent is not None for agent in self._present])
        return obs, acting, not agents, score


# ---- in the process ------------------------------------------------------------------------------

_served: EnvScene | None = None


def ask(scene: bytes, method: str, *given: Any) -> Any:
    """What a method of this process's scene gives; the scene is made for the first question.

    Args:
        scene: the pickled function that makes it, the same for every question.
        method: name.
        given: to the method.
    """
    global _served
    if _served is None:
        _served = pickle.loads(scene)()
    return getattr(_served, method)(*given)
