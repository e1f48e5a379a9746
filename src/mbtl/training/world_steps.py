"""Trainings of the jax engine that pause and go on, and what they and evaluations cost in steps.

A training that was extended is, bit for bit, the one of the whole length: all that decides the
future is in its file, and learning rates and exploration follow the whole length.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.errors import InvalidInput
from mbtl.trainer import OnProgress, Progress, Reached

if TYPE_CHECKING:
    from mbtl.training.world_trainer import WorldTrainer

_CHECKS, _CHECKED_AT = "checks", "checked_at"
_CHECK_TIMES, _CHECK_SHARE = 50, 20


class WorldSteps:
    """The part of `WorldTrainer` that counts steps (`mbtl.trainer.SteppingTrainer`)."""

    @property
    def whole_steps(self) -> int | None:
        """Environment steps of a whole training; None where episodes are counted."""
        trainer = cast("WorldTrainer", self)
        if trainer.timesteps is None:
            return None
        unit = trainer.update_length
        return -(-trainer.timesteps // unit) * unit

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
        """Train until `steps` are done in all, rounded up to whole updates.

        The policy has the latest weights, whatever `checkpoint` says: who counts steps evaluates
        policies on the way, and the best of them serves. A training evaluates itself only where
        that can end it early, which is where a perfect return is one of episodes that last.

        Args:
            context: to train on.
            seed: of the training; the same seed gives the same policy.
            steps: in all, 1..`whole_steps`.
            start: a policy to begin from; the critic, which no policy carries, begins anew.
            saved: file of the training, to go on from; None: it cannot go on later.
            on_progress: told steps.

        Raises:
            InvalidInput: this trainer counts episodes, its world cannot be saved, or `start` has
                another shape.
            TrainingFailed: the weights became NaN.
        """
        import mbtl.training.jax as engine

        trainer = cast("WorldTrainer", self)
        _check_counted(trainer)
        world, params = trainer._lessons([context])
        if saved is not None and not getattr(world, "storable", True):
            raise InvalidInput(
                f"a training in {world!r} lives in one process and cannot be saved, so it cannot "
                "go on later; give no file, or train whole trainings (a budget without cost=)"
            )
        recipe, checked = trainer.learner, _may_end(world)
        begin = engine.start(world, recipe, [seed], params)
        weights = None if start is None else _beginning(engine, start, begin.state.weights)
        file = engine.SavedTraining(saved)
        resume = file.load(lambda: begin)

        def on_block(block: Any) -> None:
            at = int(block.training.updates)
            latest = float(block.training.latest_return[0]) if checked else None
            if latest is not None and at > file.notes.get(_CHECKED_AT, 0):
                lasted = round(latest * trainer.checkpoint_episodes)
                file.notes[_CHECKS] = file.notes.get(_CHECKS, 0) + lasted
                file.notes[_CHECKED_AT] = at
            if on_progress is not None:
                metrics = {} if latest is None else {"episode_return": latest}
                on_progress(Progress(block.steps, block.total, metrics))
            file.save(block.training)

        training = engine.train(
            world,
            recipe,
            [seed],
            params,
            trainer.length,
            on_block=on_block,
            checkpoint_every=_check_every(trainer, world) if checked else None,
            checkpoint_episodes=trainer.checkpoint_episodes,
            acting=trainer._how,
            only_best=checked,
            weights=weights,
            resume=resume,
            until=steps,
            judging=checked,
        )
        file.save(training, done=True)
        done = int(training.updates) * trainer.update_length
        best = float(training.best_return[0])
        return Reached(
            engine.export_policies(world, training.state.weights, recipe.activation)[0],
            done,
            file.notes.get(_CHECKS, 0),
            ended=checked and best >= cast(float, world.max_return),
        )

    def evaluate_steps(
        self, policy: Any, contexts: Sequence[Context], seed: int
    ) -> tuple[Array, Array]:
        """As `evaluate`, and how many steps each episode had, both (n_targets, eval_episodes)."""
        trainer = cast("WorldTrainer", self)
        returns = trainer.evaluate(policy, contexts, seed)
        world, _ = trainer.problem(list(contexts))
        lasts = _lasts(world)
        if lasts == "return":
            return returns, returns.copy()
        if lasts == "horizon":
            return returns, np.full(returns.shape, float(world.env.horizon))
        if not hasattr(world, "env"):
            raise InvalidInput(
                f"only worlds of one agent count the steps of an episode, got {world!r}; count "
                "trainings instead (a budget without cost=)"
            )
        counting = replace(trainer, problem=_Counting(trainer.problem))
        return returns, counting.evaluate(policy, contexts, seed)


@dataclass(frozen=True)
class Counted:
    """An environment whose every step is worth 1, so that a return is a number of steps."""

    env: Any

    def __getattr__(self, name: str) -> Any:
        if name == "env" or name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.env, name)

    def step(self, state: Any, action: Any, params: Any) -> Any:
        """One step of the environment."""
        moved = self.env.step(state, action, params)
        return moved._replace(reward=moved.reward * 0.0 + 1.0)


@dataclass(frozen=True)
class _Counting:
    """contexts -> the world of counted steps, and its parameters."""

    problem: Callable[[Sequence[Context]], tuple[Any, Any]]

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, Any]:
        world, params = self.problem(contexts)
        return replace(world, env=Counted(world.env)), params


def _lasts(world: Any) -> str | None:
    return getattr(getattr(world, "env", None), "lasts", None)


def _may_end(world: Any) -> bool:
    """Whether a training can be found to have nothing left to gain."""
    return world.max_return is not None and _lasts(world) == "return"


def _check_every(trainer: WorldTrainer, world: Any) -> int:
    """Steps between two evaluations of itself: every 2 %, and they cost a twentieth at most."""
    dearest = trainer.checkpoint_episodes * int(world.env.horizon)
    often = -(-trainer.length // _CHECK_TIMES)
    return trainer.checkpoint_every or max(often, _CHECK_SHARE * dearest)


def _check_counted(trainer: WorldTrainer) -> None:
    if trainer.timesteps is None:
        raise InvalidInput(
            "only trainings that are counted in steps can be paid in steps, got a recipe of "
            f"{trainer.episodes} episodes; count trainings instead (a budget without cost=)"
        )


def _beginning(engine: Any, policy: Any, fresh: Any) -> Any:
    """Weights of one training that acts as a policy does; its critic is a fresh one."""
    if not hasattr(policy, "weights"):
        raise InvalidInput(
            f"a training begins from a policy of this engine, got {type(policy).__name__}; train "
            "one with this trainer"
        )
    actor = engine.import_actor([policy])
    return fresh._replace(actor=actor.network, log_std=actor.log_std)
