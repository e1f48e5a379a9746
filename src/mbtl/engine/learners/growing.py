"""Trainings whose length nobody knows beforehand: a trunk, and a branch where they may end.

Along the trunk the learning rate falls slowly, as one over the root of the updates. Where the
training may end, a branch leaves it, along which the rate falls to zero; the policy is at its end.
Whoever goes on goes on along the trunk, as if there had been no branch (Zhai et al. 2022, "Scaling
Vision Transformers", section 3.5; Hu et al. 2024, "MiniCPM", section 4).
The branch is the last fifth of what was asked for: a training of n updates costs n updates, and one
of n more as many more.

Notation (shapes): P trainings, leading axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

from mbtl.engine.learners.algorithms import AnyRecipe
from mbtl.engine.learners.blocks import Block, Training, copied
from mbtl.engine.learners.clock import Pace
from mbtl.engine.learners.episodic.episodes import Acting
from mbtl.engine.learners.export import export_policies
from mbtl.engine.learners.loop import start, train
from mbtl.engine.learners.networks import Weights
from mbtl.engine.worlds.environments import Tree
from mbtl.engine.worlds.world import World
from mbtl.portfolio import MLPPolicy

SHARE = 0.2
"""Of a stage that is the branch (docs/decisions.md)."""

SLOWING = 0.1
"""Units after which the rate along the trunk has fallen by sqrt(2) (docs/decisions.md)."""


def stage(updates: int) -> tuple[int, int]:
    """Of so many updates those along the trunk, and those along the branch that leaves it then.

    A single one is all trunk.
    """
    branch = round(SHARE * updates)
    return updates - branch, branch


class Growing(NamedTuple):
    """P trainings that may become any length.

    Attributes:
        world: the dynamics.
        recipe: hyper-parameters.
        seeds: P training seeds.
        params: of the P contexts, or sets of contexts.
        whole: updates of one unit, within a share of which exploration falls.
        before: updates of the trainings that these are tuned from, as long as these ones
            (docs/decisions.md).
        judged: updates between two evaluations, of which the best one is the policy; 0: the latest
            weights are.
        episodes: of an evaluation, on all contexts together.
        acting: how actions are chosen there.
    """

    world: World
    recipe: AnyRecipe
    seeds: Sequence[int]
    params: Tree
    whole: int
    before: int = 0
    judged: int = 0
    episodes: int = 1
    acting: Acting = "mean"

    def start(self, weights: Weights | None = None) -> Training:
        """Before the first update, from these weights or from scratch."""
        return start(self.world, self.recipe, self.seeds, self.params, weights)

    def along(
        self, trunk: Training, until: int, on_block: Callable[[Block], None] | None = None
    ) -> Training:
        """The trunk up to so many updates from its root; its memory before is used again.

        Raises:
            TrainingFailed: weights are no longer finite.
        """
        return self._learn(trunk, until, self._endless, on_block)

    def end(
        self, trunk: Training, branch: int, on_block: Callable[[Block], None] | None = None
    ) -> Weights:
        """Weights at the end of a branch of so many updates; the trunk stays as it is.

        Where they are judged, the best ones of the trunk so far and of this branch; those of other
        branches are forgotten.

        Raises:
            TrainingFailed: weights are no longer finite.
        """
        begin = int(trunk.updates)
        pace = self._endless.branch(begin, begin + max(branch, 1))
        ended = self._learn(copied(trunk), begin + branch, pace, on_block)
        return cast(Weights, ended.best if self.judged else ended.state.weights)

    @property
    def _endless(self) -> Pace:
        return Pace.endless(self.whole, SLOWING * self.whole, self.before)

    def policies(self, weights: Weights) -> list[MLPPolicy]:
        """The P policies that such weights are."""
        return export_policies(self.world, weights, self.recipe.activation)

    def _learn(
        self, training: Training, until: int, pace: Pace, on_block: Callable[[Block], None] | None
    ) -> Training:
        if until == 0:  # it begins at its end, from the policy that it had
            return training
        unit = self.recipe.update_length
        return train(
            self.world,
            self.recipe,
            self.seeds,
            self.params,
            until * unit,
            on_block=on_block,
            checkpoint_every=self.judged * unit or None,
            checkpoint_episodes=self.episodes,
            acting=self.acting,
            resume=training,
            judging=self.judged > 0,
            pace=pace,
        )
