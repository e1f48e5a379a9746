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
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.errors import InvalidInput, TrainingFailed
from mbtl.faults import located
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


T = TypeVar("T")
_Playing = Generator[None, Any, T]


@dataclass(frozen=True)
class Job:
    """Episodes to play in one environment.

    Attributes:
        open_env: makes (or hands out) the environment.
        seeds: one per episode, given to `reset`.
        score: what an episode is worth; None: the sum of its rewards.
        measures: keys of the last step's `info`, of numbers to note beside that.
        context: of the environment, which its faults name; None: not known.
    """

    open_env: Callable[[], Any]
    seeds: Sequence[int]
    score: Score | None = None
    measures: Sequence[str] = ()
    context: Context | None = None


@dataclass(eq=False)
class _Place:
    """One environment at play, and what a policy is told of it.

    Attributes:
        job: what is played.
        found: what each episode is worth, and its measures.
        lasted: steps of the episodes that are over, all their strata together.
        env: where.
        keep_open: its owner closes it.
        observations: one per decision maker.
        memory: state of a recurrent policy, None at an episode's start.
        rng: of sampled actions.
    """

    job: Job
    found: list[Array]
    lasted: list[int]
    env: Any
    keep_open: bool
    observations: list[Any] = field(default_factory=list)
    memory: tuple[Any, ...] | None = None
    rng: np.random.Generator | None = None

    def __post_init__(self) -> None:
        self.playing = self._play()

    def goes_on(self, actions: Sequence[Any] | None = None) -> bool:
        """Until somebody has to decide again, with an action of each; False: all was played."""
        try:
            self.playing.send(actions)
        except StopIteration:
            return False
        return True

    def _play(self) -> _Playing[None]:
        """All episodes."""
        shares = () if self.job.score is None else self.job.score.shares(self.env)
        strata = [(share, {"options": {"stratum": k}}) for k, share in enumerate(shares)]
        try:
            for seed in self.job.seeds:
                worth, steps = np.zeros(1 + len(self.job.measures)), 0
                for share, given in strata or [(1.0, {})]:
                    with located(self.job.context):
                        told, lasted = yield from self._episode(seed, given)
                    worth, steps = worth + share * told, steps + lasted
                self.found.append(worth)
                self.lasted.append(steps)
        finally:
            if not self.keep_open:
                end(self.env)

    def _episode(self, seed: int, given: Mapping[str, Any]) -> _Playing[tuple[Array, int]]:
        """What one, or a stratum of it, is worth, with its measures; and its steps."""
        env, score, is_team = self.env, self.job.score, hasattr(self.env, "possible_agents")
        seen, _ = env.reset(seed=seed, **given)
        self.memory, self.rng = None, np.random.default_rng(action_seed(seed))
        info: Mapping[str, Any] = {}
        total, steps, ended = 0.0, 0, False
        while True:
            agents = list(env.agents) if is_team else []
            self.observations = [copied(seen[a]) for a in agents] if is_team else [copied(seen)]
            broken = _has_nan(seen)  # so it counts as not played
            if broken or ended or not self.observations:
                break
            actions = yield
            if is_team:
                seen, rewards, _, _, infos = env.step(dict(zip(agents, actions, strict=True)))
                reward, info = sum(rewards.values()), next(iter(infos.values()), {})
            else:
                seen, reward, terminated, truncated, info = env.step(actions[0])
                ended = terminated or truncated
            total += float(reward)
            ended = ended or (score is not None and score.is_foretold(info))
            steps += 1
            if steps > LONGEST_EPISODE:
                raise endless()
        if broken:
            info = {}
        elif not steps and score is not None:  # nobody had to decide
            info = env.summary
        worth = np.nan if broken else total if score is None else score.read(info)
        told = [float(info.get(name, np.nan)) for name in self.job.measures]
        return np.array([worth, *told]), steps


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
        try:
            observations = _stacked(seen)
        except (KeyError, ValueError) as error:
            raise _of_many_shapes(places, seen) from error
        extra: dict[str, Any] = {}
        if "action_masks" in self._wants:
            masks = [place.env.get_wrapper_attr("action_masks")() for place in places]
            extra["action_masks"] = np.stack(masks)
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
    found: list[list[Array]] = [[] for _ in jobs]
    lasted: list[list[int]] = [[] for _ in jobs]
    waiting = deque(zip(jobs, found, lasted, strict=True))
    places: list[_Place] = []
    try:
        while waiting or places:
            while waiting and len(places) < max_envs:
                job, worth, steps = waiting.popleft()
                with located(job.context):
                    place = _Place(job, worth, steps, job.open_env(), keep_open)
                if not keep_open and any(place.env is other.env for other in places):
                    raise one_instance()
                if place.goes_on():
                    places.append(place)
            told = zip(places, actor.actions(places), strict=True)
            places = [place for place, actions in told if place.goes_on(actions)]
    finally:
        for place in places:
            place.playing.close()
    width = [1 + len(job.measures) for job in jobs]
    tables = [np.reshape(rows, (-1, n)) for rows, n in zip(found, width, strict=True)]
    return tables, [np.asarray(steps, dtype=np.float64) for steps in lasted]


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


def _of_many_shapes(places: Sequence[_Place], seen: Sequence[Any]) -> InvalidInput:
    """Observations that one policy cannot see together: two of their shapes, with contexts."""
    found = {str(_shape(one)): place.job.context for place, one in zip(places, seen, strict=True)}
    listed = [f"{shape} in {context}" if context else shape for shape, context in found.items()]
    return InvalidInput(
        f"observations must have one shape in every context, got {' and '.join(listed[:2])}; let "
        "make_env pad the shorter ones, and try `mbtl check`"
    )


def _shape(observation: Any) -> Any:
    if isinstance(observation, dict):
        return {key: np.shape(part) for key, part in observation.items()}
    return np.shape(observation)


def _memories(places: Sequence[_Place]) -> tuple[tuple[Any, ...] | None, Any]:
    """States of a recurrent policy, (layers, B, width) each, and where an episode starts."""
    known = next((place.memory for place in places if place.memory is not None), None)
    starts = np.array([place.memory is None for place in places])
    if known is None:
        return None, starts
    blank = tuple(np.zeros_like(part) for part in known)
    memories = [blank if place.memory is None else place.memory for place in places]
    return tuple(np.stack(parts, axis=1) for parts in zip(*memories, strict=True)), starts
