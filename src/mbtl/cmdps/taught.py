"""Trainers whose one policy for all contexts learns by a curriculum (`mbtl.curricula`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from mbtl.contexts import Context
from mbtl.curricula import Curriculum, curriculum_named
from mbtl.errors import InvalidInput
from mbtl.objective import Bounds
from mbtl.training import WorldTrainer


@dataclass(frozen=True)
class TaughtProblem:
    """contexts -> world with a curriculum, and parameters; see `world_trainer.Problem`.

    Attributes:
        problem: the same without it.
        curriculum: the rule.
        bounds: of returns.
    """

    problem: Callable[[Sequence[Context]], tuple[Any, Any]]
    curriculum: Curriculum
    bounds: Bounds

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, Any]:
        """The world, and the parameters of `contexts` with one leading axis.

        Raises:
            InvalidInput: its simulations do not start again one by one.
        """
        from mbtl.worlds.taught import taught

        world, params = self.problem(contexts)
        return taught(world, self.curriculum, self.bounds), params


def with_curriculum(
    trainer: Any, curriculum: Curriculum | str, bounds: Bounds | None
) -> WorldTrainer:
    """The trainer, whose policies for several contexts learn by a curriculum.

        trainer = with_curriculum(cmdp.trainer_for("full"), "regret", cmdp.normalisation)
        InJax(trainer, cmdp.space.contexts, "ppo", 1_000_000).run(0, folder, on_step)

    Trainings on one context are as without.

    Args:
        trainer: of the jax engine; it counts steps.
        curriculum: the rule, or a name in `mbtl.curricula.CURRICULA`.
        bounds: what performance 0 and 1 mean.

    Raises:
        UnknownName: there is no such curriculum.
        InvalidInput: another trainer, or no bounds.
    """
    rule = curriculum_named(curriculum) if isinstance(curriculum, str) else curriculum
    if not isinstance(trainer, WorldTrainer) or trainer.unit != "timesteps":
        raise InvalidInput(
            "a curriculum needs a training in the jax engine that counts steps, got "
            f"{_described(trainer)}; leave it out, or train with --engine jax where there is one"
        )
    if bounds is None:
        raise InvalidInput(
            "a curriculum needs bounds of the returns, got None; give (low, high) as Bounds"
        )
    return replace(trainer, problem=TaughtProblem(trainer.problem, rule, bounds))


def _described(trainer: Any) -> str:
    unit = " that counts episodes" if isinstance(trainer, WorldTrainer) else ""
    return f"{type(trainer).__name__}{unit}"
