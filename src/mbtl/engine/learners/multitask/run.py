"""A multi-task baseline from start to end in a folder: interrupted at any time, it goes on there.

The folder holds what it belongs to (`settings.json`) and per seed the latest training
(`seed0.npz`, saved now and then). Each file appears whole or not at all.

Notation (shapes): S seeds, N contexts.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from mbtl.arrays import Array
from mbtl.engine.learners.blocks import Block
from mbtl.engine.learners.evaluation import evaluate_multitask
from mbtl.engine.learners.loop import CHECKPOINT_EPISODES, train_multitask
from mbtl.engine.learners.recipes import MultiTaskRecipe
from mbtl.engine.learners.saving import SavedTraining
from mbtl.engine.worlds.environments import Tree
from mbtl.engine.worlds.world import World
from mbtl.errors import InvalidInput
from mbtl.files import claimed_folder
from mbtl.seeds import MATRIX_TRIAL, PER_TARGET, episode_seeds, evaluation_seeds, training_seed

CHECKPOINTS = ("best", "final")


class Judged(NamedTuple):
    """When a policy is judged, by as many episodes of each context; the best one is kept.

    `every` is environment steps between two times, None for 50 times in all.
    """

    episodes: int = CHECKPOINT_EPISODES
    every: int | None = None


USUAL = Judged()

OnProgress = Callable[[int, int, int, float], None]
"""Called with (seed, steps done, steps planned, mean return over all contexts)."""


@dataclass(frozen=True, eq=False)
class MultiTaskRun:
    """What `run_multitask` found.

    Attributes:
        returns: per checkpoint, (S, N) mean raw return over episodes.
        std: per checkpoint, (S, N) standard deviation over episodes, with n - 1; 0 of a single one.
        provenance: one JSON-able record per seed: what decides the numbers, and how long it took.
    """

    returns: Mapping[str, Array]
    std: Mapping[str, Array]
    provenance: tuple[Mapping[str, Any], ...]


def multitask_settings(
    world: World,
    recipe: MultiTaskRecipe,
    params: Tree,
    timesteps: int,
    episodes: int,
    judged: Judged = USUAL,
) -> dict[str, Any]:
    """What decides the numbers of `run_multitask`, apart from its seeds; JSON-able."""
    return {
        "environment": repr(world),
        "recipe": recipe.record,
        "contexts": _digest(params),
        "timesteps": timesteps,
        "episodes": episodes,
        "evaluation_seeds": PER_TARGET,
        "checkpoint_episodes": judged.episodes,
        **({} if judged.every is None else {"checkpoint_every": judged.every}),
    }


def run_multitask(
    world: World,
    recipe: MultiTaskRecipe,
    params: Tree,
    seeds: Sequence[int],
    timesteps: int,
    folder: str | Path,
    *,
    episodes: int = 100,
    judged: Judged = USUAL,
    on_progress: OnProgress | None = None,
) -> MultiTaskRun:
    """Train one policy per seed on all of N contexts and evaluate it on each.

    Evaluations play the episodes of the transfer matrix of the same seed, so that baselines and
    portfolios are compared on common random numbers.

    Args:
        world: the dynamics.
        recipe: hyper-parameters.
        params: N contexts, leading axis.
        seeds: roots of the seed tree; the training is that of the source after the last.
        timesteps: environment steps per policy, over all contexts together.
        folder: where it grows; made when missing. Nothing in it is removed.
        episodes: per context.
        judged: when, on the way.
        on_progress: told after each block of a training.

    Raises:
        InvalidInput: the folder holds something else, or a number is below 1.
        StorageError: the place cannot be written, or another process works there.
        TrainingFailed: weights are no longer finite.
    """
    if not seeds or episodes < 1:
        raise InvalidInput(
            f"a run needs at least one seed and episode, got {len(seeds)} and {episodes}"
        )
    place = Path(folder)
    settings = multitask_settings(world, recipe, params, timesteps, episodes, judged)
    rows: dict[str, list[Array]] = {name: [] for name in CHECKPOINTS}
    records = []
    with claimed_folder(place, settings, "a multi-task run"):
        for seed in seeds:
            begin = time.monotonic()
            # sources are 0..N-1, so this training is none of theirs
            own = training_seed(seed, MATRIX_TRIAL, len(params.visible))
            training = train_multitask(
                world,
                recipe,
                [own],
                params,
                timesteps,
                checkpoint_every=judged.every,
                checkpoint_episodes=judged.episodes,
                on_block=on_progress and partial(_on_block, on_progress, seed),
                saved=SavedTraining(place / f"seed{seed}.npz"),
            )
            seconds = round(time.monotonic() - begin, 1)
            n = len(params.visible)
            numbers = episode_seeds(evaluation_seeds(seed, MATRIX_TRIAL, range(n)), n, episodes)
            for name, weights in (("best", training.best), ("final", training.state.weights)):
                rows[name] += [*evaluate_multitask(world, recipe, weights, params, numbers)]
            records.append(
                {
                    **settings,
                    "trainer": "mbtl-jax-multitask",
                    "seed": seed,
                    "training_seed": own,
                    "steps": int(training.updates) * recipe.update_length,
                    "checkpoint_return": float(training.best_return[0]),
                    "train_seconds_of_last_run": seconds,
                }
            )
    found, freedom = {name: np.stack(rows[name]) for name in CHECKPOINTS}, min(1, episodes - 1)
    return MultiTaskRun(
        {name: each.mean(axis=2) for name, each in found.items()},
        {name: each.std(axis=2, ddof=freedom) for name, each in found.items()},
        tuple(records),
    )


def _on_block(on_progress: OnProgress, seed: int, block: Block) -> None:
    on_progress(seed, block.steps, block.total, float(block.training.latest_return[0]))


def _digest(params: Tree) -> str:
    """Tells other contexts, or other features shown, apart."""
    parts = [np.ascontiguousarray(x, dtype=np.float64) for x in jax.tree.leaves(params)]
    text = b"".join(str(x.shape).encode() + x.tobytes() for x in parts)
    return hashlib.sha256(text).hexdigest()[:16]
