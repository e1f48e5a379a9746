"""Traffic with many decision makers: a PettingZoo parallel environment whose agents come and go."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Unpack

import numpy as np
from gymnasium.spaces import Space
from gymnasium.utils.seeding import np_random

from mbtl.cmdps.traffic.environment import Settings, Traffic
from mbtl.contexts import Value
from mbtl.errors import missing_extra

try:
    from pettingzoo import ParallelEnv
except ModuleNotFoundError as error:
    raise missing_extra("pettingzoo", "traffic") from error


class TrafficTeam(Traffic, ParallelEnv):  # type: ignore[misc]  # pettingzoo is untyped for our checker
    """Controlled cars that share one policy, so that spaces are the same for all.

    A car without an action drives by itself: `step({})` is traffic without control.

    Attributes:
        agents: controlled cars on the road.
        possible_agents: every car that can be controlled in this episode.
        most_agents: how many there can be at once.
        np_random: where every draw of an episode comes from.
    """

    most_agents: int

    def __init__(
        self, context: Mapping[str, Value] | None = None, **settings: Unpack[Settings]
    ) -> None:
        """Arguments as in `Traffic`."""
        super().__init__(context, **settings)
        self.agents: list[str] = []
        self.possible_agents: list[str] = []
        self._observation_space: Space[Any]
        self._action_space: Space[Any]
        self._seed(None)

    def observation_space(self, agent: str) -> Space[Any]:
        """The same for every agent."""
        return self._observation_space

    def action_space(self, agent: str) -> Space[Any]:
        """The same for every agent."""
        return self._action_space

    def drive(self) -> Any:
        """One decision in which nobody is told anything: the unguided baseline."""
        return self.step({})

    def _seed(self, seed: int | None) -> None:
        self.np_random: np.random.Generator = np_random(seed)[0]

    def close(self) -> None:
        """End the simulation and remove its files."""
        self.agents = []
        super().close()
