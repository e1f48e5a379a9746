"""Rollouts: many environments stepped together, one forward pass of the policy for all of them.

One environment per target plays its episodes back to back; when it has finished them, its place
goes to the next target. A policy always sees `ROWS` observations at a time (padded when fewer are
left), so its arithmetic, and with it every return, does not depend on the other targets. Where a
dense policy in numpy has discrete actions the best is the best in any batch: no padding there.

An environment is a Gymnasium one, or a PettingZoo parallel one whose agents share the policy. What
an episode is worth is the sum of its rewards, or the `Score` that the CMDP names: in traffic, say,
the score is a mean speed and the rewards only teach.
"""

from __future__ import annotations

import inspect
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import InvalidInput, TrainingFailed
from mbtl.score import Score
from mbtl.seeds import action_seed

__all__ = ["ENDED", "Actor", "Job", "play", "play_counted"]

ROWS = 32
"""Observations per forward pass. Of 64-64 networks 32 rows cost about twice one row; of the four
layers of 400 of a traffic signal, which plays alone, they were half of an evaluation."""

LONGEST_EPISODE = 100_000
"""An episode longer than this has no time limit; better an error than a process that hangs."""


ENDED = "mbtl.simulation_ended"
"""Key of one agent's info when the simulation of a team has ended."""


@dataclass(frozen=True)
class Job:
    """Episodes to play in one environment.

    Attributes:
        open_env: makes (or hands out) the environment.
        seeds: one per episode, given to `reset`.
        score: what an episode is worth; None: the sum of its rewards.
        measures: keys of the last step's `info`, of numbers to note beside that.
    """

    open_env: Callable[[], Any]
    seeds: Sequence[int]
    score: Score | None = None
    measures: Sequence[str] = ()


@dataclass(eq=False)
class _Place:
    """One environment at play."""

    job: int
    env: Any
    seeds: Iterator[tuple[int, float, dict[str, Any] | None]]  # and share and options of a stratum
    score: Score | None
    measures: Sequence[str]
    strata: int  # of an episode
    found: list[Array]  # what each episode is worth, and its measures
    lasted: list[int]  # steps of the episodes that are over, all their strata together
    played: int = 0  # steps of the strata of this episode that are over
    share: float = 1.0
    worth: Array | float = 0.0
    left: int = 0  # strata of this episode that are still to be played
    observations: list[Any] = field(default_factory=list)  # one per decision maker
    total: float = 0.0
    broken: bool = False  # somebody saw NaN in this episode, so it counts as not played
    steps: int = 0
    memory: tuple[Any, ...] | None = None  # state of a recurrent policy, None at an episode's start
    rng: np.random.Generator | None = None  # of sampled actions

    @property
    def is_team(self) -> bool:
        """PettingZoo's parallel interface."""
        return hasattr(self.env, "possible_agents")

    def start_episode(self) -> bool:
        """Reset for the next episode; False when all were played."""
        while (coming := next(self.seeds, None)) is not None:
            seed, self.share, options = coming
            first, _ = self.env.reset(
                seed=seed, **({} if options is None else {"options": options})
            )
            self.observations = (
                [copied(first[a]) for a in self.env.agents] if self.is_team else [copied(first)]
            )
            self.total, self.steps, self.memory = 0.0, 0, None
            self.broken = _has_nan(first)
            self.rng = np.random.default_rng(action_seed(seed))
            if self.observations and not self.broken:
                return True
            known = self.broken or self.score is None
            self._book({} if known else self.env.summary)  # nobody had to decide, or can
        return False

    @classmethod
    def of(cls, number: int, job: Job, found: list[Array], lasted: list[int]) -> _Place:
        """Before its first episode."""
        env = job.open_env()
        shares = () if job.score is None else job.score.shares(env)
        parts: list[tuple[float, dict[str, Any] | None]] = [
            (share, {"stratum": k}) for k, share in enumerate(shares)
        ] or [(1.0, None)]
        coming = ((seed, share, options) for seed in job.seeds for share, options in parts)
        n = len(parts)
        return cls(number, env, coming, job.score, job.measures, n, found, lasted, left=n)

    def _book(self, info: Mapping[str, Any]) -> None:
        """What an episode is worth, once all of its strata were played."""
        if self.broken:
            info, score = {}, np.nan
        else:
            score = self.total if self.score is None else self.score.read(info)
        told = [float(info.get(name, np.nan)) for name in self.measures]
        self.worth = self.worth + self.share * np.array([score, *told])
        self.played += self.steps
        self.left -= 1
        if self.left == 0:
            self.found.append(np.asarray(self.worth))
            self.lasted.append(self.played)
            self.worth, self.played, self.left = 0.0, 0, self.strata

    def step(self, actions: Sequence[Any]) -> bool:
        """Take one step with one action per decision maker; True when the episode is over."""
        ended, info = self._team_step(actions) if self.is_team else self._step(actions[0])
        self.steps += 1
        ended = ended or self.broken
        if self.steps > LONGEST_EPISODE:
            raise endless()
        if ended:
            self._book(info)
        return ended

    def _step(self, action: Any) -> tuple[bool, Mapping[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.broken = _has_nan(observation)
        self.observations = [copied(observation)]
        self.total += float(reward)
        return terminated or truncated or self._is_foretold(info), info

    def _team_step(self, actions: Sequence[Any]) -> tuple[bool, Mapping[str, Any]]:
        agents = list(self.env.agents)
        seen, rewards, _, _, infos = self.env.step(dict(zip(agents, actions, strict=True)))
        agents, self.broken = self.env.agents, _has_nan(seen)
        self.observations = [copied(seen[agent]) for agent in agents]
        self.total += float(sum(rewards.values()))
        info: Mapping[str, Any] = next(iter(infos.values()), {})
        return not agents or self._is_foretold(info), info

    def _is_foretold(self, info: Mapping[str, Any]) -> bool:
        return self.score is not None and self.score.is_foretold(info)


def _has_nan(observation: Any) -> bool:
    """Of one decision maker or, by name, of several."""
    if isinstance(observation, Mapping):
        return any(map(_has_nan, observation.values()))
    if isinstance(observation, tuple):
        return any(map(_has_nan, observation))
    numbers = np.asarray(observation)
    return numbers.dtype.kind == "f" and bool(np.isnan(numbers).any())


@dataclass(frozen=True)
class Actor:
    """Asks a policy for actions, in full batches of `ROWS` where rounding depends on their size.

    Attributes:
        policy: anything with Stable-Baselines3's `predict`; recurrent and masked policies are
            recognised by its parameters `state` and `action_masks`.
        sampled: draw the actions, from the seed of the episode alone; needs an `MLPPolicy`.

    Raises:
        InvalidInput: sampled actions of a policy that takes no generator.
    """

    policy: Any
    sampled: bool = False
    _wants: frozenset[str] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        names = inspect.signature(self.policy.predict).parameters
        object.__setattr__(self, "_wants", frozenset(names))
        if self.sampled and "rng" not in names:
            raise InvalidInput(
                "sampled actions need a policy whose predict takes a generator `rng`, as dense "
                f"ones do, got {type(self.policy).__name__}; use acting='mean'"
            )

    def actions(self, places: Sequence[_Place]) -> list[list[Any]]:
        """Per place one action for each of its decision makers."""
        if self.sampled:
            return [
                list(self.policy.predict(_stacked(p.observations), False, p.rng)[0]) for p in places
            ]
        makers = [(place, seen) for place in places for seen in place.observations]
        chosen: list[Any] = []
        exact = getattr(self.policy, "row_by_row", False)
        for start in range(0, len(makers), ROWS):
            batch = makers[start : start + ROWS]
            padded = batch if exact else [*batch, *[batch[-1]] * (ROWS - len(batch))]
            chosen.extend(self._predict(*zip(*padded, strict=True))[: len(batch)])
        shares = iter(chosen)
        return [[next(shares) for _ in place.observations] for place in places]

    def _predict(self, places: Sequence[_Place], seen: Sequence[Any]) -> Any:
        observations = _stacked(seen)
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
        Per job what each episode is worth, in the order of its seeds.
    """
    played, _ = play_counted(jobs, actor, max_envs=max_envs, keep_open=keep_open)
    return [found[:, 0] for found in played]


def play_counted(
    jobs: Sequence[Job], actor: Actor, *, max_envs: int, keep_open: bool = False
) -> tuple[list[Array], list[Array]]:
    """Per job (episodes, 1 + measures), what each is worth first; and how many steps each had.

    A measure that is not told is NaN.
    """
    waiting = deque(enumerate(jobs))
    found: list[list[Array]] = [[] for _ in jobs]
    lasted: list[list[int]] = [[] for _ in jobs]
    places: list[_Place] = []
    try:
        while waiting or places:
            while waiting and len(places) < max_envs:
                number, job = waiting.popleft()
                place = _Place.of(number, job, found[number], lasted[number])
                if not keep_open and any(place.env is other.env for other in places):
                    raise one_instance()
                places.append(place)
                if not place.start_episode():
                    places.remove(place)
                    if not keep_open:
                        end(place.env)
            finished = []
            for place, actions in zip(places, actor.actions(places), strict=True):
                if place.step(actions) and not place.start_episode():
                    finished.append(place)
            for place in finished:
                places.remove(place)
                if not keep_open:
                    end(place.env)
    finally:
        if not keep_open:
            for place in places:
                end(place.env)
    width = [1 + len(job.measures) for job in jobs]
    worth = [np.reshape(rows, (-1, n)) for rows, n in zip(found, width, strict=True)]
    return worth, [np.asarray(steps, dtype=np.float64) for steps in lasted]


def end(env: Any) -> None:
    """Close it; while something else is raised, that counts, whatever the closing makes of it."""
    try:
        env.close()
    except Exception:  # an interrupt in the middle of a call leaves a simulator that cannot answer
        if sys.exc_info()[1] is None:
            raise


def one_instance() -> InvalidInput:
    """The second environment of a factory is its first."""
    return InvalidInput(
        "make_env must make a new environment at every call, got the same instance twice; build "
        "it inside the function"
    )


def endless() -> TrainingFailed:
    """An episode that does not end."""
    return TrainingFailed(
        f"an episode must end, got {LONGEST_EPISODE:,} steps without an end; wrap the environment "
        "in gymnasium.wrappers.TimeLimit"
    )


def copied(observation: Any) -> Any:
    """An observation that the environment cannot change any more."""
    if isinstance(observation, np.ndarray):
        return observation.copy()
    if isinstance(observation, Mapping):
        return {key: copied(part) for key, part in observation.items()}
    if isinstance(observation, tuple):
        return tuple(copied(part) for part in observation)
    return observation


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
