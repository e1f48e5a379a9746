"""A multi-task baseline from start to end in a folder: interrupted at any time, it goes on there.

Two kinds of one interface: `InJax`, the vectorised methods, and `InSimulator`, any other trainer.

Notation (shapes): N contexts, E episodes.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.files import claimed_folder, whole_file
from mbtl.provenance import here
from mbtl.seeds import MATRIX_TRIAL, evaluation_seed, training_seed
from mbtl.trainer import Progress
from mbtl.training.sb3 import SB3Trainer
from mbtl.training.world_trainer import WorldTrainer

Method = Literal["ppo", "paco", "moore"]

OnStep = Callable[[int, int, str], None]
"""Called with (done, total, a note)."""

Found = tuple[Array, Array, dict[str, Any]]
"""(N,) mean returns, (N,) standard deviations over episodes, and a JSON-able record."""

_TOGETHER = 10
"""Contexts evaluated at once in a simulator, between two signs of life."""


@dataclass(frozen=True)
class InJax:
    """Vectorised: context-conditioned PPO, PaCo or MOORE.

    Attributes:
        trainer: of one source; gives the dynamics.
        contexts: the N contexts.
        method: which of the three.
        length: environment steps, over all contexts together.
        eval_episodes: E.
    """

    trainer: WorldTrainer
    contexts: Sequence[Context]
    method: Method
    length: int
    eval_episodes: int

    @property
    def settings(self) -> dict[str, Any]:
        """What decides the numbers, apart from the seed; JSON-able."""
        import mbtl.training.jax as engine

        return engine.multitask_settings(*self._problem(), self.length, self.eval_episodes)

    def run(self, seed: int, folder: Path, on_step: OnStep) -> Found:
        """The policy of one seed, on every context.

        Raises:
            InvalidInput: the folder holds something else.
            StorageError: it cannot be written, or another process works there.
            TrainingFailed: weights are no longer finite.
        """
        import mbtl.training.jax as engine

        env, recipe, params = self._problem()
        run = engine.run_multitask(
            env,
            recipe,
            params,
            [seed],
            self.length,
            folder,
            episodes=self.eval_episodes,
            on_progress=lambda _, done, total, value: on_step(done, total, f"return {value:.0f}"),
        )
        record = {"checkpoint": "best", "final_mean_return": float(run.returns["final"].mean())}
        return run.returns["best"][0], run.std["best"][0], {**run.provenance[0], **record}

    def _problem(self) -> tuple[Any, Any, Any]:
        import mbtl.training.jax as engine

        env, params = self.trainer.problem(self.contexts)
        return env, engine.multitask_recipe(self.method, type(env.env).__name__), params


@dataclass(frozen=True)
class InSimulator:
    """By Stable-Baselines3, or in a twin.

    Attributes:
        trainer: with the length of this training.
        contexts: the N contexts.
        problem: what else decides the policy, of the CMDP; JSON-able.
    """

    trainer: SB3Trainer | WorldTrainer
    contexts: Sequence[Context]
    problem: Mapping[str, Any]

    @property
    def method(self) -> str:
        """Name of the algorithm, as in the names of files."""
        return str(self.trainer.algorithm).lower()

    @property
    def length(self) -> int:
        """Episodes, or steps where those are counted."""
        return self.trainer.episodes or getattr(self.trainer, "timesteps", None) or 0

    @property
    def settings(self) -> dict[str, Any]:
        """What decides the numbers, apart from the seed; JSON-able."""
        from mbtl.training.multitask import recipe_on_all

        return {**self.problem, "recipe": recipe_on_all(self.trainer)}

    def run(self, seed: int, folder: Path, on_step: OnStep) -> Found:
        """The policy of one seed, on every context.

        Raises:
            InvalidInput: the folder holds something else.
            StorageError: it cannot be written, or another process works there.
            TrainingFailed: the training failed.
        """
        chosen = training_seed(seed, MATRIX_TRIAL, len(self.contexts))  # the source after the last
        decides = {**self.problem, "seed": seed, **self.settings["recipe"]}
        del decides["eval_episodes"]  # more of them need no other policy
        with claimed_folder(folder, decides, "a multi-task policy"):
            policy, trained = self._policy(chosen, folder, on_step)
        rows, play = [], evaluation_seed(seed, MATRIX_TRIAL)
        for first in range(0, len(self.contexts), _TOGETHER):
            done = f"evaluated on {first} of {len(self.contexts)} contexts"
            on_step(self.length, self.length, done)
            some = self.contexts[first : first + _TOGETHER]
            rows.append(self.trainer.evaluate(policy, some, play))
        returns = np.concatenate(rows)
        record = {
            **self.settings,
            "seed": seed,
            "training_seed": chosen,
            "training": trained,
        }
        spread = returns.std(axis=1, ddof=min(1, returns.shape[1] - 1))
        return returns.mean(axis=1), spread, record

    def _policy(self, chosen: int, folder: Path, on_step: OnStep) -> tuple[Any, dict[str, Any]]:
        """Trained now or by an interrupted run, and by which code and how long that was."""
        from mbtl.training.multitask import train_on_all

        done = folder / "trained.json"
        if done.is_file():
            return self.trainer.load(folder / "policy"), json.loads(done.read_text("utf-8"))

        def on_progress(progress: Progress) -> None:
            note = " ".join(f"{k} {v:.2f}" for k, v in progress.metrics.items())
            on_step(progress.step, progress.total, note)

        begin, origin = time.process_time(), here()
        partial = folder / "training.npz"
        policy = train_on_all(self.trainer, self.contexts, chosen, on_progress, partial=partial)
        trained = {"train_seconds_of_last_run": round(time.process_time() - begin, 1), **origin}
        (folder / "policy").mkdir(exist_ok=True)
        self.trainer.save(policy, folder / "policy")
        with whole_file(done) as file:
            file.write(json.dumps(trained).encode())
        partial.unlink(missing_ok=True)
        return policy, trained
