"""What an environment gives without any policy of ours: random actions, and what goes by itself.

They are played in the same episodes as policies are evaluated in, so a row of policies can be
compared with them. *Unguided* is the system without a controller: an environment says how it goes
on by itself with a method `drive()`, which returns what `step` does. One that has controllers of
its own names them in `ways`, and takes a step of one with `follow(way)`. Many have no such thing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.envs.rollout import Actor, Job, play_counted
from mbtl.errors import check_known
from mbtl.score import RANDOM_ACTIONS, SCORE, Score

__all__ = ["ByItself", "Controller", "RandomActions", "going", "played", "ways_in", "ways_of"]

UNGUIDED = "unguided"


def ways_in(make_env: Callable[[Context], Any], context: Context) -> tuple[str, ...]:
    """How an environment goes without a policy, random actions first."""
    with closing(make_env(context)) as env:
        return (RANDOM_ACTIONS, *ways_of(env))


def going(
    way: str, make_env: Callable[[Context], Any], context: Context
) -> tuple[Actor, Callable[[Context], Any]]:
    """Who acts where a system goes one of its `ways_in`, and in what environments.

    Raises:
        UnknownName: there is no such way.
    """
    env = make_env(context)
    known, space = (RANDOM_ACTIONS, *ways_of(env)), env.action_space
    env.close()
    check_known("way", way, known)
    policy = RandomActions(space("") if callable(space) else space)
    make = make_env if way == RANDOM_ACTIONS else lambda one: ByItself(make_env(one), way)
    return Actor(policy, sampled=True), make


def played(
    make_env: Callable[[Context], Any],
    who: Actor | str,
    contexts: Sequence[Context],
    seeds: Sequence[Sequence[int]],
    names: Sequence[str] = (),
    *,
    score: Score | None,
    max_envs: int,
) -> tuple[dict[str, Array], Array]:
    """What the last steps of episodes tell, by name, and the steps that each had.

    Args:
        make_env: context -> environment.
        who: acts there, or one of its `ways_in`.
        contexts: n of them.
        seeds: (n, E) of the episodes in each.
        names: of measures beside the score. Episodes are then played to their end also where their
            score is foretold.
        score: what an episode is worth; None: the sum of its rewards.
        max_envs: environments alive at once.

    Returns:
        (n, E) each, the score among them; and (n, E) steps.
    """
    if names and score is not None:
        score = replace(score, foretold=None)
    actor, make = going(who, make_env, contexts[0]) if isinstance(who, str) else (who, make_env)
    pairs = zip(contexts, seeds, strict=True)
    jobs = [Job(partial(make, one), own, score, names, one) for one, own in pairs]
    found, lasted = play_counted(jobs, actor, max_envs=max_envs)
    told = {
        name: np.array([rows[:, k] for rows in found]) for k, name in enumerate((SCORE, *names))
    }
    return told, np.array(lasted)


@dataclass(frozen=True)
class Controller:
    """A function of one observation that returns an action, as a policy.

    Attributes:
        act: observation -> action.
    """

    act: Callable[[Any], Any]
    row_by_row: ClassVar[bool] = True

    def predict(self, observations: Any, deterministic: bool = True) -> tuple[list[Any], None]:
        """An action for each observation of a batch."""
        if isinstance(observations, dict):
            n = len(next(iter(observations.values())))
            rows = [{key: part[i] for key, part in observations.items()} for i in range(n)]
        else:
            rows = list(observations)
        return [self.act(row) for row in rows], None


@dataclass(frozen=True)
class RandomActions:
    """A policy that looks at nothing.

    Attributes:
        space: of the actions, of which any is as likely as another.
    """

    space: Any

    def predict(
        self, observations: Any, deterministic: bool, rng: np.random.Generator
    ) -> tuple[list[Any], None]:
        """One action for each observation, from `rng` alone."""
        some = next(iter(observations.values())) if isinstance(observations, dict) else observations
        return [self._draw(rng) for _ in range(len(some))], None

    def _draw(self, rng: np.random.Generator) -> Any:
        space = self.space
        if hasattr(space, "low") and np.isfinite([space.low, space.high]).all():
            return rng.uniform(space.low, space.high).astype(space.dtype)
        if hasattr(space, "n") and not space.shape:
            return int(space.start + rng.integers(space.n))
        space.seed(int(rng.integers(2**31)))
        return space.sample()


def ways_of(env: Any) -> tuple[str, ...]:
    """Names of the ways in which an environment goes on without decisions."""
    own = tuple(getattr(env, "ways", ()))
    return (UNGUIDED, *own) if hasattr(env, "drive") else own


class ByItself:
    """An environment whose decision makers are not heard."""

    def __init__(self, env: Any, way: str = UNGUIDED) -> None:
        """The environment has this way, one of `ways_of`."""
        self._env, self._way = env, way

    def __getattr__(self, name: str) -> Any:
        if name == "_env" or name.startswith("__"):  # in a copy that is not filled yet
            raise AttributeError(name)
        return getattr(self._env, name)

    def step(self, actions: Any) -> Any:
        """One decision without control."""
        return self._env.drive() if self._way == UNGUIDED else self._env.follow(self._way)
