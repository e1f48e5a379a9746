"""One environment as a scene: its agents have places (`mbtl.engine.worlds.processes.Scene`).

It is a Gymnasium environment, whose agent has the only place, or a PettingZoo parallel one, whose
agents come and go. What an episode is worth is as in `mbtl.envs.rollout`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.contexts import Context
from mbtl.envs.slots import seated
from mbtl.score import Score

Sight = tuple[NDArray[np.float32], NDArray[np.bool_], bool, float]
"""What `mbtl.engine.worlds.processes.Sight` holds; that module needs jax."""
Step = tuple[Sight, NDArray[np.float32], NDArray[np.bool_]]


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
        first, _ = self._env.reset(seed=seed)
        if not self._is_team:
            return self._alone(first, acts=True, over=False, info={})
        over = not self._env.agents  # nobody ever has to decide
        told = over and self._score is not None
        return self._seen(first, over, self._worth(self._env.summary) if told else 0.0)

    def step(self, action: NDArray[Any] | None) -> Step:
        """One decision of all agents; None: nobody is told anything."""
        return self._step_team(action) if self._is_team else self._step(action)

    # ---- inside ------------------------------------------------------------------------------

    @property
    def _is_team(self) -> bool:
        return hasattr(self._env, "possible_agents")

    def _step(self, action: NDArray[Any] | None) -> Step:
        moved = self._env.drive() if action is None else self._env.step(action[0])
        seen, reward, terminated, truncated, info = moved
        self._total += float(reward)
        sight = self._alone(seen, not terminated, terminated or truncated, info)
        return sight, np.array([reward], np.float32), np.array([terminated], np.bool_)

    def _alone(self, seen: Any, acts: bool, over: bool, info: Mapping[str, Any]) -> Sight:
        score = self._worth(info) if over else 0.0
        return np.asarray(seen, np.float32)[None], np.array([acts]), bool(over), score

    def _step_team(self, action: NDArray[Any] | None) -> Step:
        places = {agent: k for k, agent in enumerate(self._present) if agent is not None}
        told = {} if action is None else {agent: action[k] for agent, k in places.items()}
        seen, rewards, terminated, truncated, infos = self._env.step(told)
        reward, done = np.zeros(self._places, np.float32), np.zeros(self._places, np.bool_)
        for agent, k in places.items():
            reward[k] = rewards[agent]
            done[k] = terminated[agent]
            if done[k] or (agent not in self._env.agents and not truncated[agent]):
                self._present[k] = None
        self._total += float(reward.sum())
        over = not self._env.agents
        info: Mapping[str, Any] = next(iter(infos.values()), {})
        return self._seen(seen, over, self._worth(info) if over else 0.0), reward, done

    def _worth(self, info: Mapping[str, Any]) -> float:
        return self._total if self._score is None else self._score.read(info)

    def _seen(self, seen: Mapping[str, Any], over: bool, score: float) -> Sight:
        seated(self._present, self._env.agents)
        size = self._env.observation_space("").shape
        obs = np.zeros((self._places, *size), np.float32)
        for k, agent in enumerate(self._present):
            if agent is not None:
                obs[k] = seen[agent]
        acting = np.array([agent is not None for agent in self._present])
        return obs, acting, over, score
