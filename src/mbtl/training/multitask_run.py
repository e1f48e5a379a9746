"""The vectorised multi-task baselines, as `mbtl.benchmark.on_all` has those of any trainer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.training.world_trainer import WorldTrainer

Method = Literal["ppo", "paco", "moore"]

OnStep = Callable[[int, int, str], None]
"""Called with (done, total, a note)."""


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

    def run(self, seed: int, folder: Path, on_step: OnStep) -> tuple[Array, Array, dict[str, Any]]:
        """(N,) mean returns of the policy of one seed, their deviations, and a JSON-able record.

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
