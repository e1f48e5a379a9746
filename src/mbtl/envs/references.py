"""What an environment gives without any policy of ours: random actions, and what goes by itself.

They are played in the same episodes as policies are evaluated in, so a row of policies can be
compared with them. *Unguided* is the system without a controller: an environment says how it goes
on by itself with a method `drive()`, which returns what `step` does. One that has controllers of
its own names them in `ways`, and takes a step of one with `follow(way)`. Many have no such thing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.envs.rollout import Actor, Job, play, play_counted
from mbtl.score import Score

__all__ = [
    "ByItself",
    "RandomActions",
    "measured",
    "reference_rows",
    "ways_of",
]

RANDOM_ACTIONS = "random_actions"
UNGUIDED = "unguided"


def reference_rows(
    make_env: Callable[[Context], Any],
    contexts: Sequence[Context],
    seeds: Sequence[Sequence[int]],
    *,
    max_envs: int,
    score: Score | None = None,
) -> dict[str, Array]:
    """Returns in every context, (n_contexts, n_episodes) by name.

    Args:
        make_env: context -> environment, Gymnasium's or PettingZoo's.
        contexts: where to play.
        seeds: of the episodes in each context.
        max_envs: environments alive at once.
        score: what an episode is worth; None: the sum of its rewards.
    """
    first = make_env(contexts[0])
    ways = ways_of(first)
    space = first.action_space
    policy = RandomActions(space("") if callable(space) else space)
    first.close()
    actor = Actor(policy, sampled=True)
    makers: dict[str, Callable[[Context], Any]] = {RANDOM_ACTIONS: make_env}
    for way in ways:
        makers[way] = partial(_by_itself, make_env, way)
    pairs = list(zip(contexts, seeds, strict=True))
    return {
        name: np.array(
            play(
                [Job(partial(make, one), own, score) for one, own in pairs],
                actor,
                max_envs=max_envs,
            )
        )
        for name, make in makers.items()
    }


def measured(
    make_env: Callable[[Context], Any],
    acting: Sequence[tuple[Actor, Sequence[Context]]],
    seeds: Sequence[Sequence[int]],
    names: Sequence[str],
    *,
    max_envs: int,
    score: Score | None = None,
) -> dict[str, dict[str, Array]]:
    """What episodes' last steps tell beside the score (`mbtl.engine.WorldTrainer.beside`).

    Args:
        make_env: context -> environment.
        acting: policies, and where each serves.
        seeds: of the episodes in each context, policy by policy.
        names: of the measures, keys of the last step's `info`.
        max_envs: environments alive at once.
        score: what an episode is worth. It is played to its end also where that is foretold.
    """
    whole = None if score is None else replace(score, foretold=None)
    every = [context for _, some in acting for context in some]
    first = make_env(every[0])
    ways = ways_of(first)[-1:]
    first.close()

    def jobs(make: Callable[[Context], Any]) -> list[Job]:
        pairs = zip(every, seeds, strict=True)
        return [Job(partial(make, one), own, whole, names) for one, own in pairs]

    rows: dict[str, list[Array]] = {"policies": []}
    waiting = iter(jobs(make_env))
    for actor, some in acting:
        own = [next(waiting) for _ in some]
        rows["policies"] += play_counted(own, actor, max_envs=max_envs)[0]
    for way in ways:
        nobody = jobs(partial(_by_itself, make_env, way))
        rows[way] = play_counted(nobody, acting[0][0], max_envs=max_envs)[0]
    columns = ("score", *names)
    return {
        who: dict(zip(columns, np.moveaxis(np.array(some), -1, 0), strict=True))
        for who, some in rows.items()
    }


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
        return getattr(self._env, name)

    def step(self, actions: Any) -> Any:
        """One decision without control."""
        return self._env.drive() if self._way == UNGUIDED else self._env.follow(self._way)


def _by_itself(make_env: Callable[[Context], Any], way: str, context: Context) -> ByItself:
    return ByItself(make_env(context), way)
