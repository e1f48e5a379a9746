"""Rollouts: many environments stepped together, one forward pass of the policy for all of them.

One environment per target plays its episodes back to back; when it has finished them, its place
goes to the next target. The policy always sees `ROWS` observations at a time (padded when fewer are
left), so its arithmetic, and with it every return, does not depend on the other targets.
"""

from __future__ import annotations

import inspect
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import TrainingFailed

ROWS = 32
"""Observations per forward pass. Measured on 64-64 networks: 32 rows cost about twice one row."""

LONGEST_EPISODE = 1_000_000
"""An episode longer than this has no time limit; better an error than a process that hangs."""


class Env(Protocol):
    """The part of `gymnasium.Env` that rollouts use."""

    def reset(self, *, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        ...

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Observation, reward, terminated, truncated, info."""
        ...

    def close(self) -> None:
        """Free what the environment holds."""
        ...


@dataclass(frozen=True)
class Job:
    """Episodes to play in one environment.

    Attributes:
        open_env: makes (or hands out) the environment.
        seeds: one per episode, given to `reset`.
    """

    open_env: Callable[[], Env]
    seeds: Sequence[int]


@dataclass(eq=False)
class _Place:
    """One environment at play."""

    job: int
    env: Env
    seeds: Iterator[int]
    returns: list[float]
    observation: Any = None
    total: float = 0.0
    steps: int = 0
    memory: tuple[Any, ...] | None = None  # state of a recurrent policy, None at an episode's start

    def start_episode(self) -> bool:
        """Reset for the next episode; False when all were played."""
        seed = next(self.seeds, None)
        if seed is None:
            return False
        self.observation, _ = self.env.reset(seed=seed)
        self.total, self.steps, self.memory = 0.0, 0, None
        return True

    def step(self, action: Any) -> bool:
        """Take one step; True when the episode is over."""
        self.observation, reward, terminated, truncated, _ = self.env.step(action)
        self.total += float(reward)
        self.steps += 1
        if self.steps > LONGEST_EPISODE:
            raise TrainingFailed(
                f"an episode must end, got more than {LONGEST_EPISODE} steps; wrap the environment "
                "in gymnasium.wrappers.TimeLimit"
            )
        if terminated or truncated:
            self.returns.append(self.total)
        return terminated or truncated


@dataclass(frozen=True)
class Actor:
    """Asks a policy for deterministic actions in batches of `ROWS`.

    Attributes:
        policy: anything with Stable-Baselines3's `predict`; recurrent and masked policies are
            recognised by its parameters `state` and `action_masks`.
    """

    policy: Any
    _wants: frozenset[str] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        names = inspect.signature(self.policy.predict).parameters
        object.__setattr__(self, "_wants", frozenset(names))

    def actions(self, places: Sequence[_Place]) -> list[Any]:
        """One action per place."""
        actions: list[Any] = []
        for start in range(0, len(places), ROWS):
            batch = places[start : start + ROWS]
            padded = [*batch, *[batch[-1]] * (ROWS - len(batch))]
            actions.extend(self._predict(padded)[: len(batch)])
        return actions

    def _predict(self, places: Sequence[_Place]) -> Any:
        observations = _stacked([place.observation for place in places])
        extra: dict[str, Any] = {}
        if "action_masks" in self._wants:
            extra["action_masks"] = np.stack([_action_mask(place.env) for place in places])
        if "state" in self._wants:
            extra["state"], extra["episode_start"] = _memories(places)
        chosen, state = self.policy.predict(observations, deterministic=True, **extra)
        if state is not None:
            for i, place in enumerate(places):
                place.memory = tuple(part[:, i] for part in state)
        return chosen


def play(
    jobs: Sequence[Job], actor: Actor, *, max_envs: int, keep_open: bool = False
) -> list[Array]:
    """Play all episodes of all jobs.

    Args:
        jobs: environments and their episode seeds.
        actor: chooses the actions.
        max_envs: environments alive at once, >= 1.
        keep_open: leave the environments open: their owner closes them.

    Returns:
        Per job the undiscounted return of each episode, in the order of its seeds.
    """
    waiting = deque(enumerate(jobs))
    returns: list[list[float]] = [[] for _ in jobs]
    places: list[_Place] = []
    try:
        while waiting or places:
            while waiting and len(places) < max_envs:
                number, job = waiting.popleft()
                places.append(_Place(number, job.open_env(), iter(job.seeds), returns[number]))
                places[-1].start_episode()
            finished = []
            for place, action in zip(places, actor.actions(places), strict=True):
                if place.step(action) and not place.start_episode():
                    finished.append(place)
            for place in finished:
                places.remove(place)
                if not keep_open:
                    place.env.close()
    finally:
        if not keep_open:
            for place in places:
                place.env.close()
    return [np.asarray(r, dtype=np.float64) for r in returns]


def _stacked(observations: Sequence[Any]) -> Any:
    if isinstance(observations[0], dict):
        return {key: np.stack([o[key] for o in observations]) for key in observations[0]}
    return np.stack(observations)


def _memories(places: Sequence[_Place]) -> tuple[tuple[Any, ...] | None, Any]:
    """States of a recurrent policy, (layers, B, width) each, and where an episode starts."""
    known = next((place.memory for place in places if place.memory is not None), None)
    starts = np.array([place.memory is None for place in places])
    if known is None:
        return None, starts
    blank = tuple(np.zeros_like(part) for part in known)
    memories = [blank if place.memory is None else place.memory for place in places]
    return tuple(np.stack(parts, axis=1) for parts in zip(*memories, strict=True)), starts


def _action_mask(env: Any) -> Any:
    return env.get_wrapper_attr("action_masks")()
