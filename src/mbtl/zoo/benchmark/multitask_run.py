"""The vectorised multi-task baselines, as `mbtl.zoo.benchmark.on_all` has those of any trainer.

CartPole and Pendulum have recipes of their own; every other world is learnt by that of one source,
its copies spread over the contexts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.engine import lazy as engine
from mbtl.engine.world_trainer import WorldTrainer, recipe_on_many
from mbtl.errors import InvalidInput
from mbtl.trainers.contract import refusal

Method = Literal["ppo", "paco", "moore"]

_EPISODES = 100
"""Per context, where an episode costs next to nothing."""
_MOST, _LEAST = 50, 5
"""How often a policy is judged on all contexts, which is to cost no more than its training."""

OnStep = Callable[[int, int, str], None]
"""Called with (done, total, a note)."""


@dataclass(frozen=True)
class InJax:
    """Vectorised: context-conditioned PPO, PaCo or MOORE.

    Attributes:
        trainer: of one source; gives the dynamics, and the recipe where there is none for many.
        contexts: the N contexts.
        method: which of the three.
        length: environment steps, over all contexts together.
        eval_episodes: E; None: those of one source, of CartPole and Pendulum 100.

    Raises:
        InvalidInput: the trainer does not learn by PPO.
    """

    trainer: WorldTrainer
    contexts: Sequence[Context]
    method: Method
    length: int
    eval_episodes: int | None = None

    def __post_init__(self) -> None:
        if why := refusal(self.trainer, "sets"):
            raise InvalidInput(why)

    @property
    def settings(self) -> dict[str, Any]:
        """What decides the numbers, apart from the seed; JSON-able."""
        world, recipe, params, judged, episodes = self._problem()
        return engine.multitask_settings(world, recipe, params, self.length, episodes, judged)

    def run(self, seed: int, folder: Path, on_step: OnStep) -> tuple[Array, Array, dict[str, Any]]:
        """(N,) mean returns of the policy of one seed, their deviations, and a JSON-able record.

        Raises:
            InvalidInput: the folder holds something else.
            StorageError: it cannot be written, or another process works there.
            TrainingFailed: weights are no longer finite.
        """
        world, recipe, params, judged, episodes = self._problem()
        run = engine.run_multitask(
            world,
            recipe,
            params,
            [seed],
            self.length,
            folder,
            episodes=episodes,
            judged=judged,
            on_progress=lambda _, done, total, value: on_step(done, total, f"return {value:.0f}"),
        )
        record = {"checkpoint": "best", "final_mean_return": float(run.returns["final"].mean())}
        return run.returns["best"][0], run.std["best"][0], {**run.provenance[0], **record}

    def _problem(self) -> tuple[Any, Any, Any, Any, int]:
        """World, recipe, parameters, when it is judged on the way, and E."""
        world, params = self.trainer.problem(self.contexts)
        name, n = type(getattr(world, "env", world)).__name__, len(self.contexts)
        recipe = recipe_on_many(self.trainer, world, n, self.method)
        if name in engine.MULTI_TASK:
            return world, recipe, params, engine.Judged(), self.eval_episodes or _EPISODES
        once = n * int(world.decisions(params))
        every = min(max(once, math.ceil(self.length / _MOST)), math.ceil(self.length / _LEAST))
        judged = engine.Judged(1, every)
        return world, recipe, params, judged, self.eval_episodes or self.trainer.eval_episodes
