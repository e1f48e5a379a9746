"""Seeded rollouts of an environment, recorded so that two can be compared exactly.

Notation (shapes): T recorded moments, F numbers of the flattened observation.
    observations  (T, F)   of every reset and every step, in order
    rewards       (T,)     0 at a reset
    endings       (T,)     0 goes on, 1 terminated, 2 truncated, 3 both; -1 at a reset
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.envs.rollout import end
from mbtl.errors import InvalidInput
from mbtl.seeds import action_seed

if TYPE_CHECKING:
    from mbtl.envs.spaces import Outside

_RESET = -1

_Moment = tuple[Array, "Outside | None", float, int]


@dataclass(frozen=True, eq=False)
class Rollout:
    """What one environment showed under a fixed list of actions.

    Attributes:
        outside: the first observation that is far outside its space, else the first that is not
            in it, with its moment; None: all are in it.
    """

    observations: Array
    rewards: Array
    endings: NDArray[np.int8]
    outside: Outside | None = None

    def not_finite(self) -> str | None:
        """The first NaN or infinity, in words; None when all numbers are finite."""
        for name, values in (("observation", self.observations), ("reward", self.rewards)):
            rows = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
            if rows.size:
                return f"{name} {values[rows[0]]} at moment {rows[0]}"
        return None


def draw_actions(action_space: Any, n: int, seed: int) -> list[Any]:
    """`n` random actions; the space is left with another random state.

    Raises:
        InvalidInput: it is no space, but, say, a list of those of several agents.
    """
    if not callable(getattr(action_space, "sample", None)):
        raise InvalidInput(
            f"actions are one space of gymnasium.spaces, got {action_space}; make those of several "
            "agents one vector, or give a PettingZoo parallel environment"
        )
    action_space.seed(action_seed(seed))
    return [action_space.sample() for _ in range(n)]


def roll(env: Any, actions: Iterable[Any], seed: int) -> Rollout:
    """Reset with `seed`, take the actions, and reset without a seed whenever an episode ends."""
    return _record(list(_moments(env, actions, seed)))


def roll_together(envs: Sequence[Any], actions: Sequence[Any], seed: int) -> list[Rollout]:
    """The same rollouts with the environments taking turns, moment by moment."""
    turns = zip_longest(*(_moments(env, actions, seed) for env in envs))
    return [_record([moment for moment in log if moment]) for log in zip(*turns, strict=True)]


def difference(one: Rollout, other: Rollout, *, dynamics_only: bool = False) -> str | None:
    """The first difference, in words; None when the rollouts are equal to the last bit.

    Args:
        one: a rollout.
        other: a rollout with the same actions and seed.
        dynamics_only: leave out the numbers of the observation that never change within a rollout.
            They are labels, such as a visible context feature; a context that changes nothing else
            does not act on the dynamics.
    """
    n = min(len(one.rewards), len(other.rewards))
    a, b = one.observations, other.observations
    if a.shape[1] != b.shape[1]:
        return f"observations have {a.shape[1]} and {b.shape[1]} numbers"
    if dynamics_only:
        moving = (a != a[0]).any(axis=0) | (b != b[0]).any(axis=0)
        a, b = a[:, moving], b[:, moving]
    differs = {
        "observation": _unequal(a[:n], b[:n]),
        "reward": _unequal(one.rewards[:n, None], other.rewards[:n, None]),
        "end of the episode": one.endings[:n] != other.endings[:n],
    }
    first = {what: int(mask.argmax()) for what, mask in differs.items() if mask.any()}
    if not first:
        return None  # equal endings mean equal lengths: the number of actions is the same
    what = min(first, key=lambda name: first[name])
    return f"{what} at moment {first[what]}"


@contextmanager
def opened(*makers: Any) -> Iterator[list[Any]]:
    """Environments from argument-less makers, closed at the end."""
    with ExitStack() as stack:
        envs = []
        for make in makers:
            envs.append(make())
            stack.callback(end, envs[-1])
        yield envs


def _moments(env: Any, actions: Iterable[Any], seed: int) -> Iterator[_Moment]:
    from gymnasium import spaces

    from mbtl.envs.spaces import outside  # needs Gymnasium, as environments do

    space = env.observation_space
    if not space.is_np_flattenable:
        raise InvalidInput(f"observations must flatten to a fixed number of values, got {space}")

    def seen(observation: Any) -> tuple[Array, Outside | None]:
        miss = outside(space, observation)
        try:
            return np.array(spaces.flatten(space, observation), dtype=np.float64), miss
        except (IndexError, KeyError, TypeError, ValueError):  # a choice or key that there is not
            if miss is None:
                raise
            raise InvalidInput(
                f"observations must lie in their space {space}, got {miss.said}; mend the space "
                "or the observation"
            ) from None

    yield *seen(_reset(env, seed)), 0.0, _RESET
    for action in actions:
        result = env.step(action)
        if not (isinstance(result, tuple) and len(result) == 5):
            raise InvalidInput(
                "step(action) must return (observation, reward, terminated, truncated, info), got "
                f"{type(result).__name__} of {len(result) if isinstance(result, tuple) else 1}"
            )
        observation, reward, terminated, truncated, _ = result
        yield *seen(observation), float(reward), int(terminated) + 2 * int(truncated)
        if terminated or truncated:
            yield *seen(_reset(env, None)), 0.0, _RESET


def _reset(env: Any, seed: int | None) -> Any:
    result = env.reset(seed=seed)
    if not (isinstance(result, tuple) and len(result) == 2):
        raise InvalidInput(
            f"reset(seed=...) must return (observation, info), got {type(result).__name__}"
        )
    return result[0]


def _record(moments: Sequence[_Moment]) -> Rollout:
    observations, missed, rewards, endings = zip(*moments, strict=True)
    misses = [
        replace(miss, said=f"{miss.said}, at moment {i}") for i, miss in enumerate(missed) if miss
    ]
    worst = next((miss for miss in misses if miss.far), misses[0] if misses else None)
    codes = np.asarray(endings, dtype=np.int8)
    return Rollout(np.stack(observations), np.asarray(rewards), codes, worst)


def _unequal(a: Array, b: Array) -> NDArray[np.bool_]:
    """(T,) True where a row differs; NaN equals NaN."""
    unequal: NDArray[np.bool_] = ((a != b) & ~(np.isnan(a) & np.isnan(b))).any(axis=1)
    return unequal
