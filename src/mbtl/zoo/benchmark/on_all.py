"""One policy for all contexts by any trainer that knows how, from start to end in a folder.

Interrupted at any time it goes on there. (`multitask_run` has vectorised methods.)

Notation (shapes): N contexts, E episodes.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.files import claimed_folder, whole_file
from mbtl.provenance import here
from mbtl.seeds import MATRIX_TRIAL, PER_TARGET, evaluation_seeds, training_seed
from mbtl.trainers.contract import Progress, Trainer, recipe_of

OnStep = Callable[[int, int, str], None]
"""Called with (done, total, a note)."""

Found = tuple[Array, Array, dict[str, Any]]
"""(N,) mean returns, (N,) standard deviations over episodes, and a JSON-able record."""

_TOGETHER = 10
"""Contexts evaluated at once, between two signs of life."""


@dataclass(frozen=True)
class InSimulator:
    """The baseline by a trainer.

    Attributes:
        trainer: with the length of this training.
        contexts: the N contexts.
        problem: what else decides the policy, of the CMDP; JSON-able.
    """

    trainer: Trainer
    contexts: Sequence[Context]
    problem: Mapping[str, Any]

    @property
    def method(self) -> str:
        """Name of the algorithm, as in the names of files."""
        return str(getattr(self.trainer, "algorithm", "policy")).lower()

    @property
    def length(self) -> int:
        """Episodes, or steps where those are counted."""
        return self.trainer.whole or 0

    @property
    def settings(self) -> dict[str, Any]:
        """What decides the numbers, apart from the seed; JSON-able."""
        recipe = {**recipe_of(self.trainer), **getattr(self.trainer, "on_sets", {})}
        return {**self.problem, "recipe": recipe, "evaluation_seeds": PER_TARGET}

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
        rows, n = [], len(self.contexts)
        for first in range(0, n, _TOGETHER):
            on_step(self.length, self.length, f"evaluated on {first} of {n} contexts")
            some = range(first, min(first + _TOGETHER, n))
            seeds = evaluation_seeds(seed, MATRIX_TRIAL, some)
            rows.append(self.trainer.evaluate(policy, [self.contexts[i] for i in some], seeds))
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
        done = folder / "trained.json"
        if done.is_file():
            return self.trainer.load(folder / "policy"), json.loads(done.read_text("utf-8"))

        def on_progress(progress: Progress) -> None:
            note = " ".join(f"{k} {v:.2f}" for k, v in progress.metrics.items())
            on_step(progress.step, progress.total, note)

        begin, origin = time.process_time(), here()
        state = folder / "training.npz"
        policy = self.trainer.train(
            self.contexts, chosen, state=state, on_progress=on_progress
        ).policy
        trained = {"train_seconds_of_last_run": round(time.process_time() - begin, 1), **origin}
        (folder / "policy").mkdir(exist_ok=True)
        self.trainer.save(policy, folder / "policy")
        with whole_file(done) as file:
            file.write(json.dumps(trained).encode())
        state.unlink(missing_ok=True)
        return policy, trained
