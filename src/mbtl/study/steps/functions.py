"""Plain functions as a trainer whose trainings go on: so many more steps, from a policy on."""

from __future__ import annotations

import inspect
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.errors import InvalidInput
from mbtl.trainer import FunctionTrainer, OnProgress, Reached

_ROOM = "policy"
_DONE = "done.json"


@dataclass(frozen=True)
class SteppedFunctions(FunctionTrainer):
    """`train(context, seed, steps, start=None, on_progress=None)` as a `SteppingTrainer`.

    The function trains for `steps` more, on from the policy `start`. So what a training keeps of
    itself is what `save_fn` writes: extending is as exact as that is. The seed is the same each
    time.

    Attributes:
        whole_steps: environment steps of a whole training.
    """

    whole_steps: int | None = None

    @property
    def begins_from(self) -> bool:
        """Whether a training can begin with the weights of another one."""
        return "start" in inspect.signature(self.train_fn).parameters

    @classmethod
    def of(
        cls,
        train: Callable[..., Any],
        evaluate: Callable[..., Any],
        save: Callable[[Any, Path], None] | None,
        load: Callable[[Path], Any] | None,
        whole_steps: int,
        train_on: Callable[..., Any] | None = None,
    ) -> FunctionTrainer:
        """A trainer of functions; one of fixed length where `train` takes no `steps`."""
        if "steps" not in inspect.signature(train).parameters:
            return FunctionTrainer(train, evaluate, save, load)
        if train_on is not None:
            return SteppedFunctionsOnSets(
                train, evaluate, save, load, whole_steps=whole_steps, train_on_fn=train_on
            )
        return SteppedFunctions(train, evaluate, save, load, whole_steps=whole_steps)

    def train_steps(
        self,
        context: Context,
        seed: int,
        steps: int,
        *,
        start: Any = None,
        saved: Path | None = None,
        on_progress: OnProgress | None = None,
    ) -> Reached:
        """Train for what is missing to `steps`; `saved` is a folder with the policy so far.

        Raises:
            InvalidInput: it is to go on later, and there are no save and load functions.
        """
        goes_on = steps < (self.whole_steps or 0)
        return self._reached(
            self.train_fn, context, seed, steps, goes_on, start, saved, on_progress
        )

    def _reached(
        self,
        function: Callable[..., Any],
        on: Any,
        seed: int,
        steps: int,
        goes_on: bool,
        start: Any,
        saved: Path | None,
        on_progress: OnProgress | None,
    ) -> Reached:
        """What is missing to `steps`, on from the policy that was saved."""
        done = 0
        if saved is not None and self.save_fn is None and goes_on:
            raise InvalidInput(
                "a training goes on from its saved policy, and these functions save none; give "
                "save and load functions, or make the study with one length"
            )
        if saved is not None and (saved / _DONE).is_file():
            done = int(json.loads((saved / _DONE).read_text(encoding="utf-8"))["steps"])
            start = self.load(saved / _ROOM)
            if done >= steps:
                return Reached(start, done)
        given: dict[str, Any] = {"start": start, "on_progress": on_progress}
        known = inspect.signature(function).parameters
        named = {name: value for name, value in given.items() if name in known}
        policy = function(on, seed, steps=steps - done, **named)
        if saved is not None and self.save_fn is not None:
            self._keep(policy, saved, steps)
        return Reached(policy, steps)

    def evaluate_steps(
        self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int]
    ) -> tuple[Array, Array]:
        """As `evaluate`; NaN, since of plain functions nobody knows how long an episode was."""
        returns = self.evaluate(policy, contexts, seeds)
        return returns, np.full(returns.shape, np.nan)

    def _keep(self, policy: Any, saved: Path, steps: int) -> None:
        """The folder appears whole or not at all."""
        beside = saved.with_name(f".{saved.name}.new")
        shutil.rmtree(beside, ignore_errors=True)
        (beside / _ROOM).mkdir(parents=True)
        self.save(policy, beside / _ROOM)
        (beside / _DONE).write_text(json.dumps({"steps": steps}), encoding="utf-8")
        shutil.rmtree(saved, ignore_errors=True)
        beside.rename(saved)


@dataclass(frozen=True)
class SteppedFunctionsOnSets(SteppedFunctions):
    """And `train_on(contexts, seed, steps, start=None, on_progress=None)`: a `SetTrainer`.

    Attributes:
        train_on_fn: trains one policy on several contexts for `steps` more.
    """

    train_on_fn: Callable[..., Any] | None = None

    @property
    def functions(self) -> dict[str, Any]:
        """Where a user's own code is (`mbtl.trainer.code_of`)."""
        return {**super().functions, "train_on": self.train_on_fn}

    def check_on_set(self) -> None:
        """A function can do what it was given for."""

    def train_on_steps(
        self,
        contexts: Sequence[Context],
        seed: int,
        steps: int,
        *,
        marks: Sequence[int],
        saved: Path | None = None,
        on_progress: OnProgress | None = None,
    ) -> Reached:
        """Train for what is missing to `steps`; see `train_steps`."""
        assert self.train_on_fn is not None
        goes_on = steps < marks[-1]
        return self._reached(
            self.train_on_fn, contexts, seed, steps, goes_on, None, saved, on_progress
        )
