"""Trainings of the jax engine that pause and go on, and what they and evaluations cost in steps.

A training that was extended is, bit for bit, the one of the whole length: all that decides the
future is in its file, and learning rates and exploration follow the whole length.

How long one policy for many contexts should be trained nobody knows beforehand. So its learning
rate falls to zero at each mark, and begins anew after it: the policy at a mark is a finished one,
and the training can still go on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.errors import InvalidInput
from mbtl.trainer import OnProgress, Progress, Reached
from mbtl.training import engine

if TYPE_CHECKING:
    from mbtl.training.world_trainer import WorldTrainer

_CHECKS, _CHECKED_AT, _STAGE = "checks", "checked_at", "stage"
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
        """Train until `steps` or episodes are done, up to whole updates (`SteppingTrainer`).

        The policy has the latest weights, whatever `checkpoint` says: who counts steps evaluates
        policies on the way, and the best of them serves. A training evaluates itself only where
        that can end it early, which is where a perfect return is one of episodes that last. Where
        it may `start` from a policy, the critic, which no policy carries, begins anew.

        Raises:
            InvalidInput: its world cannot be saved, or `start` has another shape.
            TrainingFailed: the weights became NaN.
        """
        trainer = cast("WorldTrainer", self)
        world, params = trainer._lessons([context])
        if saved is not None:
            _check_storable(world)
        recipe, checked = trainer.learner, _may_end(world)
        each = 1 if trainer.episodes is None else engine.counted.decisions_of(world, params)
        file, weights = engine.SavedTraining(saved), None
        if start is not None:
            weights = engine.taught(world, start, recipe.activation)

        def on_block(block: Any) -> None:
            at = int(block.training.updates)
            latest = float(block.training.latest_return[0]) if checked else None
            if latest is not None and at > file.notes.get(_CHECKED_AT, 0):
                lasted = round(latest * trainer.checkpoint_episodes)
                file.notes[_CHECKS] = file.notes.get(_CHECKS, 0) + lasted
                file.notes[_CHECKED_AT] = at
            if on_progress is not None:
                metrics = {} if latest is None else {"episode_return": latest}
                on_progress(Progress(block.steps * each, block.total * each, metrics))

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
            saved=file,
            until=steps,
            judging=checked,
        )
        done = int(training.updates) * trainer.update_length * each
        best = float(training.best_return[0])
        return Reached(
            engine.export_policies(world, training.state.weights, recipe.activation)[0],
            done,
            file.notes.get(_CHECKS, 0),
            ended=checked and best >= cast(float, world.max_return),
        )

    def check_pausing(self, contexts: Sequence[Context]) -> None:
        """Refuse, before anything is spent, worlds whose trainings cannot be saved."""
        _check_storable(cast("WorldTrainer", self).problem(contexts)[0])

    def check_on_set(self) -> None:
        """See `mbtl.set_trainer.SetTrainer`; where it counts steps it learns by PPO."""
        if (trainer := cast("WorldTrainer", self)).episodes is None:
            check_ppo(trainer)

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
        """Train one policy on several contexts until `steps` are done in all (`SetTrainer`).

        Context-conditioned PPO, as the multi-task baseline: the copies of the world take turns in
        the contexts, and at the marks, the last of which is the longest training, the learning rate
        has fallen to zero. Where episodes are counted it is the recipe of one source, each episode
        in another context. It does not evaluate itself, and never ends early.

        Raises:
            InvalidInput: this trainer counts steps and does not learn by PPO, its world cannot be
                saved, or there are less than two contexts.
            TrainingFailed: the weights became NaN.
        """
        trainer = cast("WorldTrainer", self)
        if len(contexts) < 2:
            raise InvalidInput(
                f"a training on several contexts takes two or more, got {len(contexts)}; use "
                "train_steps for one"
            )
        world, params = trainer._lessons(contexts)
        if saved is not None:
            _check_storable(world)
        by_steps, n = trainer.episodes is None, len(contexts)
        recipe = recipe_on_many(trainer, world, n) if by_steps else trainer.learner
        unit, file = int(recipe.update_length), engine.SavedTraining(saved)
        stops = [0, *(marks if by_steps else marks[-1:])]
        ends = [-(-mark // unit) for mark in stops]  # of the stages from mark to mark
        last = min(-(-steps // unit), ends[-1])
        each = () if by_steps else engine.counted.each_of(trainer.problem, contexts)

        def played(updates: int) -> int:
            many = updates * unit
            return many if by_steps else int(engine.episodes_met(seed, updates, n, unit) @ each)

        def fresh() -> Any:
            return engine.start_multitask(world, recipe, [seed], params)

        def on_block(block: Any) -> None:
            if on_progress is not None:
                on_progress(Progress(played(ends[stage] + block.steps // unit), total))
            if block.steps < block.total:  # the end of a stage is the beginning of the next one
                file.save(block.training)

        total = played(ends[-1])
        training = file.load(fresh) or fresh()  # its `updates` count from the last mark on
        stage = file.notes.setdefault(_STAGE, 0)
        while ends[stage] + int(training.updates) < last:
            length = ends[stage + 1] - ends[stage]
            if length:
                training = engine.train_multitask(
                    world,
                    recipe,
                    [seed],
                    params,
                    length * unit,
                    on_block=on_block,
                    judging=False,
                    resume=training,
                    until=(last - ends[stage]) * unit,
                )
            if int(training.updates) == length:
                training = training._replace(updates=training.updates * 0)
                stage = file.notes[_STAGE] = stage + 1
        file.save(training, done=True)
        policies = engine.export_policies(world, training.state.weights, recipe.activation)
        return Reached(policies[0], played(ends[stage] + int(training.updates)))

    def evaluate_steps(
        self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int] | int
    ) -> tuple[Array, Array]:
        """As `evaluate`, and how many steps each episode had, both (n_targets, eval_episodes)."""
        trainer = cast("WorldTrainer", self)
        returns = trainer.evaluate(policy, contexts, seeds)
        steps = engine.counted.known_steps(trainer.problem, contexts, returns)
        if steps is None:
            counting = replace(trainer, problem=engine.counted.Counting(trainer.problem))
            steps = counting.evaluate(policy, contexts, seeds)
        return returns, steps


def recipe_on_many(trainer: WorldTrainer, world: Any, n: int, method: str = "ppo") -> Any:
    """The recipe of one policy for n contexts.

    CartPole and Pendulum have one of their own; every other world is learnt by that of one source,
    its copies spread over the contexts.

    Raises:
        InvalidInput: the trainer does not learn by PPO.
    """
    check_ppo(trainer)
    name = type(getattr(world, "env", world)).__name__
    if name in engine.MULTI_TASK:
        return engine.multitask_recipe(method, name)  # type: ignore[arg-type]  # it checks the name
    return engine.spread_recipe(method, trainer.learner, n)  # type: ignore[arg-type]


def _may_end(world: Any) -> bool:
    """Whether a training can be found to have nothing left to gain."""
    lasts = getattr(getattr(world, "env", None), "lasts", None)
    return world.max_return is not None and lasts == "return"


def _check_every(trainer: WorldTrainer, world: Any) -> int:
    """Steps between two evaluations of itself: every 2 %, and they cost a twentieth at most."""
    dearest = trainer.checkpoint_episodes * (int(world.env.horizon) if trainer.timesteps else 1)
    often = -(-trainer.length // _CHECK_TIMES)
    return trainer.checkpoint_every or max(often, _CHECK_SHARE * dearest)


def check_ppo(trainer: WorldTrainer) -> None:
    """Refuse to learn on many contexts by anything else."""
    if trainer.algorithm != "PPO":
        raise InvalidInput(
            f"multi-task methods learn by PPO, got a recipe of {trainer.algorithm}; "
            "choose another --preset"
        )


def _check_storable(world: Any) -> None:
    """Refuse a world whose state lives in one process."""
    if not getattr(world, "storable", True):
        raise InvalidInput(
            f"a training that pauses is saved, and one in {type(world).__name__} lives in one "
            "process; choose another --engine, or count trainings (without --steps or cost=)"
        )
