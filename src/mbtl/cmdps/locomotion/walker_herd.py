"""Many walkers under way, each with a number; in this process, or shared out to more.

A walker lives from its start until it falls, arrives or has done all its steps; whoever moves it
knows its number alone. What Box2D remembers from step to step stays where the walker is, so numbers
mean nothing in another process or later run, and a walker that is asked for in vain is *lost*: all
that is known of it is not a number, with which no training goes on.
"""

from __future__ import annotations

import threading
import warnings
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.cmdps.locomotion.walker_body import (
    N_FEATURES,
    N_MOTORS,
    Constants,
    Walker,
    advance,
    luck,
)
from mbtl.elsewhere import Died, Elsewhere

NOBODY = -1
"""Number of a walker that has come to its end."""
_PATIENCE = 20
"""Episodes' steps of the whole herd after which one that nobody moved is forgotten."""
_HIGHEST = 1 << 22
"""Numbers begin again there; float32 holds them in four processes."""

Numbers = NDArray[np.int64]
Moved = tuple[NDArray[np.float32], Array, NDArray[np.bool_], Numbers]
"""(n, 24) what is seen, (n,) rewards, whether each has fallen or arrived, and its number now."""


class Herd(Protocol):
    """Walkers by number."""

    def start(self, constants: Array, noise: Array) -> tuple[Numbers, NDArray[np.float32]]:
        """New walkers.

        Args:
            constants: (n, 3), see `walker_body.Constants`.
            noise: (n, 2), see `walker_body.luck`.

        Returns:
            (n,) numbers, and (n, 24) what is seen.
        """
        ...

    def step(self, numbers: Numbers, action: NDArray[np.float32]) -> Moved:
        """One step of the walkers with these numbers; of `NOBODY` nothing is seen or earned.

        Args:
            numbers: (n,).
            action: (n, 4).
        """
        ...


@dataclass
class _UnderWay:
    walker: Walker
    left: int
    seen_at: int


class LocalHerd:
    """Walkers of this process."""

    def __init__(self, horizon: int) -> None:
        """Without any.

        Args:
            horizon: steps of an episode.
        """
        self._horizon, self._clock, self._next = horizon, 0, 0
        self._walkers: dict[int, _UnderWay] = {}

    def __len__(self) -> int:
        return len(self._walkers)

    def start(self, constants: Array, noise: Array) -> tuple[Numbers, NDArray[np.float32]]:
        """See `Herd`; as in Gymnasium the first thing seen is after a step without torque."""
        self._tick()
        walkers = [
            Walker(Constants(*own), luck(word))
            for own, word in zip(constants.tolist(), noise, strict=True)
        ]
        if not walkers:
            return np.zeros(0, np.int64), np.zeros((0, N_FEATURES), np.float32)
        seen, _, _ = advance(walkers, np.zeros((len(walkers), N_MOTORS), np.float32))
        numbers = [self._name(walker) for walker in walkers]
        return np.array(numbers, np.int64), seen

    def step(self, numbers: Numbers, action: NDArray[np.float32]) -> Moved:
        """See `Herd`."""
        self._tick()
        seen, reward, ended, after = _nothing(numbers)
        found = [self._walkers.get(number) for number in numbers.tolist()]
        there = [i for i, one in enumerate(found) if one is not None]
        ones = [one for one in found if one is not None]
        if not ones:
            return seen, reward, ended, after
        moved = advance([one.walker for one in ones], action[there])
        seen[there], reward[there], ended[there] = moved
        after[there] = numbers[there]
        for i, one, over in zip(there, ones, moved[2].tolist(), strict=True):
            one.left -= 1
            one.seen_at = self._clock
            if over or one.left == 0:
                del self._walkers[int(numbers[i])]
                one.walker.close()
                after[i] = NOBODY
        return seen, reward, ended, after

    def _name(self, walker: Walker) -> int:
        while self._next in self._walkers:
            self._next = (self._next + 1) % _HIGHEST
        number = self._next
        self._next = (number + 1) % _HIGHEST
        self._walkers[number] = _UnderWay(walker, self._horizon, self._clock)
        return number

    def _tick(self) -> None:
        """Now and then, forget walkers of trainings that have ended or were given up."""
        self._clock += 1
        if self._clock % self._horizon:
            return
        latest = self._clock - _PATIENCE * self._horizon
        for number in [n for n, one in self._walkers.items() if one.seen_at < latest]:
            self._walkers.pop(number).walker.close()


class SharedHerd:
    """Walkers in turns of this process and of others that it starts."""

    def __init__(self, horizon: int, processes: int) -> None:
        """Without any.

        Args:
            horizon: steps of an episode.
            processes: with this one, >= 1.
        """
        self._own = LocalHerd(horizon)
        self._others = [Elsewhere(partial(LocalHerd, horizon)) for _ in range(processes - 1)]
        self._alone = threading.Lock()

    def start(self, constants: Array, noise: Array) -> tuple[Numbers, NDArray[np.float32]]:
        """See `Herd`."""
        n, k = len(constants), len(self._others) + 1
        with self._alone:
            for i, other in enumerate(self._others, 1):
                other.ask("start", constants[i::k], noise[i::k])
            parts = [self._own.start(constants[::k], noise[::k])]
            parts += [_answer(other) or _lost(constants[i::k]) for i, other in self._numbered()]
        numbers, seen = np.empty(n, np.int64), np.empty((n, N_FEATURES), np.float32)
        for i, (own, shown) in enumerate(parts):
            numbers[i::k], seen[i::k] = np.where(own < 0, own, own * k + i), shown
        return numbers, seen

    def step(self, numbers: Numbers, action: NDArray[np.float32]) -> Moved:
        """See `Herd`."""
        k = len(self._others) + 1
        where = np.where(numbers < 0, 0, numbers % k)
        at = [np.flatnonzero(where == i) for i in range(k)]
        inner = np.where(numbers < 0, numbers, numbers // k)
        with self._alone:
            for i, other in self._numbered():
                other.ask("step", inner[at[i]], action[at[i]])
            parts = [self._own.step(inner[at[0]], action[at[0]])]
            parts += [_answer(other) or _nothing(inner[at[i]]) for i, other in self._numbered()]
        seen, reward, ended, after = _nothing(numbers)
        for i, some in enumerate(parts):
            here = at[i]
            seen[here], reward[here], ended[here] = some[:3]
            after[here] = np.where(some[3] < 0, some[3], some[3] * k + i)
        return seen, reward, ended, after

    def close(self) -> None:
        """End the other processes; their walkers are lost."""
        for other in self._others:
            other.close()

    def _numbered(self) -> list[tuple[int, Elsewhere]]:
        return list(enumerate(self._others, 1))


def _answer(other: Elsewhere) -> Any:
    """What it gave; None where the process has died, and its walkers with it."""
    try:
        return other.answer()
    except Died as died:
        warnings.warn(
            f"a process with walkers must not end before its walkers, got exit code {died.code}: "
            "they are lost, and trainings and evaluations with them fail; start those again",
            RuntimeWarning,
            stacklevel=2,
        )
        return None


def _nothing(numbers: Numbers) -> Moved:
    """Of walkers that have ended, zeros; of those that are lost, what is not a number."""
    n = len(numbers)
    lost = numbers != NOBODY
    seen, reward = np.zeros((n, N_FEATURES), np.float32), np.zeros(n)
    seen[lost], reward[lost] = np.nan, np.nan
    return seen, reward, np.ones(n, bool), np.full(n, NOBODY, np.int64)


def _lost(constants: Array) -> tuple[Numbers, NDArray[np.float32]]:
    n = len(constants)
    return np.full(n, NOBODY - 1, np.int64), np.full((n, N_FEATURES), np.nan, np.float32)
