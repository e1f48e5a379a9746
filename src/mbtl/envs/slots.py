"""Agents that come and go, in a fixed number of slots: what batched algorithms can step.

An agent takes the first free slot when it appears and keeps it until it leaves; then the slot is
free for another. The observation of a free slot is `BLANK`, all zeros, which no agent ever sees
(one that would is shown the smallest number above zero instead). The action of a free slot is
ignored.

    slot 0   agent a  a  a  .  .  d  d        .  blank
    slot 1   agent b  b  c  c  c  c  c        every change ends an episode of the slot
    slot 2         .  .  .  .  .  .  .

Each step moves one simulation by one decision of all its agents. When it ends, the next one starts
at once, so a slot never waits for a reset. One in which no agent ever comes is passed over, and its
score with it: to evaluate, step the environment itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete, Space
from numpy.typing import NDArray

from mbtl.envs.rollout import ENDED
from mbtl.errors import InvalidInput, SimulationFailed

__all__ = ["SlotStep", "Slots", "Together", "as_one", "is_blank", "seated"]

Observation = NDArray[np.float32]

BLANK = 0.0
"""Every number of a free slot's observation."""
_ALMOST_BLANK = float(np.finfo(np.float32).tiny)
_EMPTY_EPISODES = 1000
"""So many simulations without an agent are a mistake, not bad luck."""


class SlotStep(NamedTuple):
    """What one step gave each slot, in `info["slots"]`.

    Attributes:
        rewards: (n_slots,) of the agents that acted; 0 where none did.
        dones: (n_slots,) true where the agent has left, and where none acted.
        infos: (n_slots,) of the agents that acted; where one has left with its last observation
            "terminal_observation", "TimeLimit.truncated", and "episode" (its return and length).
            Exactly one has `ENDED`, with all that the environment told it, when the simulation has
            ended.
        ended: the simulation has ended.
    """

    rewards: NDArray[np.float32]
    dones: NDArray[np.bool_]
    infos: list[dict[str, Any]]
    ended: bool


class Slots(gymnasium.Env):  # type: ignore[misc]  # gymnasium is untyped for our checker
    """A PettingZoo parallel environment as one Gymnasium environment with one row per slot.

    Its observation is (n_slots, d), its action (n_slots, ...), its reward the sum over slots; it is
    never terminated or truncated, because the next simulation follows at once.

    Attributes:
        team: the parallel environment; all its agents have the same spaces.
        present: (n_slots,) name of the agent in each slot, or None.
        single_observation_space: of an agent.
        single_action_space: of an agent.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, make_team: Callable[[], Any], slots: int | None = None) -> None:
        """Nothing runs before `reset`.

        Args:
            make_team: makes the parallel environment.
            slots: how many agents there can be at once; missing: the environment's `most_agents`.

        Raises:
            InvalidInput: no number of slots, or observations that are not flat boxes.
        """
        self.team = make_team()
        n = getattr(self.team, "most_agents", None) if slots is None else slots
        if n is None or n < 1:
            raise InvalidInput(f"slots must be >= 1 and are not known here, got {n}; give slots=")
        self.single_observation_space: Space[Any] = self.team.observation_space("")
        self.single_action_space: Space[Any] = self.team.action_space("")
        if not isinstance(self.single_observation_space, Box):
            raise InvalidInput(f"slots need a Box to observe, got {self.single_observation_space}")
        self.observation_space = _rows(self.single_observation_space, n)
        self.action_space = _rows(self.single_action_space, n)
        self.render_mode = getattr(self.team, "render_mode", None)
        self.present: list[str | None] = [None] * n
        self._returns, self._lengths = np.zeros(n), np.zeros(n, dtype=int)

    @property
    def episode_steps(self) -> int | None:
        """Most decisions of a simulation, where the environment tells."""
        steps: int | None = getattr(self.team, "episode_steps", None)
        return steps

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a simulation; agents of the one before are forgotten."""
        super().reset(seed=seed)
        self.present = [None] * len(self.present)
        return self._begin(seed), {}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One decision of every agent; `info["slots"]` is a `SlotStep`.

        Raises:
            InvalidInput: more agents than slots.
            SimulationFailed: the simulator has stopped; `reset` starts again.
        """
        acting = {car: k for k, car in enumerate(self.present) if car is not None}
        actions = {car: action[k] for car, k in acting.items()}
        seen, rewards, terminated, truncated, infos = self.team.step(actions)
        n = len(self.present)
        ended = not self.team.agents  # while there is time, traffic goes on until somebody comes
        nothing: list[dict[str, Any]] = [{} for _ in range(n)]
        step = SlotStep(np.zeros(n, np.float32), np.ones(n, np.bool_), nothing, ended)
        for car, k in acting.items():
            step.rewards[k] = rewards[car]
            self._returns[k] += rewards[car]
            self._lengths[k] += 1
            step.dones[k] = terminated[car] or truncated[car]
            if step.dones[k]:
                step.infos[k] = {
                    "terminal_observation": _shown(seen[car]),
                    "TimeLimit.truncated": truncated[car] and not terminated[car],
                    "episode": {"r": float(self._returns[k]), "l": int(self._lengths[k])},
                }
                self.present[k] = None
        if ended:
            messenger = next(iter(acting.items()))
            step.infos[messenger[1]].update({**infos[messenger[0]], ENDED: True})
            shown = self._begin(None)
        else:
            shown = self._seat(seen)
        return shown, float(step.rewards.sum()), False, False, {"slots": step}

    def render(self) -> Any:
        """The picture of the team's simulation."""
        return self.team.render()

    def close(self) -> None:
        """End the simulation."""
        self.team.close()

    # ---- inside ------------------------------------------------------------------------------

    def _begin(self, seed: int | None) -> Observation:
        """A new simulation with at least one agent."""
        for _ in range(_EMPTY_EPISODES):
            seen, _ = self.team.reset(seed=seed)
            if self.team.agents:
                return self._seat(seen)
            seed = None  # nobody came in the whole episode: nothing to learn from it
        raise SimulationFailed(
            f"a shared policy needs agents, got {_EMPTY_EPISODES} simulations without any; let "
            "more cars be controlled"
        )

    def _seat(self, seen: dict[str, Observation]) -> Observation:
        """Give newcomers a slot; what every slot sees now."""
        for k in seated(self.present, self.team.agents):
            self._returns[k], self._lengths[k] = 0.0, 0
        shown = np.full(self.observation_space.shape, BLANK, dtype=np.float32)
        for k, car in enumerate(self.present):
            if car is not None:
                shown[k] = _shown(seen[car])
        return shown


class Together(Slots):
    """`Slots` with an end: an episode is one simulation, truncated when that has ended.

    One environment for tools that know Gymnasium only, such as `check_cmdp` and `gymnasium.make`.
    """

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """As in `Slots`; the info of an episode's last step has what one agent's has."""
        seen, reward, _, _, info = super().step(action)
        last = [one for one in info["slots"].infos if ENDED in one]
        return seen, reward, False, bool(last), {**info, **(last[0] if last else {})}


def seated(present: list[str | None], agents: Sequence[str]) -> list[int]:
    """Give agents that have none the first free slots; these slots.

    Args:
        present: name of the agent in each slot, or None; changed in place.
        agents: all that are there now.

    Raises:
        InvalidInput: more agents than slots.
    """
    there, given = set(present), []
    for agent in agents:
        if agent not in there:
            if None not in present:
                raise InvalidInput(
                    f"every agent needs a slot, got {len(agents)} agents and {len(present)} slots; "
                    "give more slots"
                )
            given.append(present.index(None))
            present[given[-1]] = agent
    return given


def as_one(env: Any) -> Any:
    """`env` itself, or a PettingZoo parallel environment as one Gymnasium environment."""
    return Together(lambda: env) if hasattr(env, "possible_agents") else env


def is_blank(observations: NDArray[Any]) -> NDArray[np.bool_]:
    """Which rows of (..., d) observations are those of free slots; shape (...)."""
    blank: NDArray[np.bool_] = (observations == BLANK).all(axis=-1)
    return blank


def _shown(observation: Observation) -> Observation:
    """An agent's observation, told from `BLANK`."""
    if is_blank(observation):
        return np.full_like(observation, _ALMOST_BLANK)
    return observation


def _rows(space: Space[Any], n: int) -> Space[Any]:
    """The space of `n` agents together."""
    if isinstance(space, Discrete):
        return MultiDiscrete([int(space.n)] * n)
    if isinstance(space, Box):
        low, high = np.stack([space.low] * n), np.stack([space.high] * n)
        return Box(low, high, dtype=space.dtype.type)
    raise InvalidInput(f"slots take Box and Discrete actions, got {space}")
