"""Multi-task baselines: one policy trained on all contexts, its return on each.

A file is called `<cmdp>-<method>-seed<k>.npz` and holds one seed: `returns` and `std` over episodes
(N,), and its provenance. Methods: "ppo" (context-conditioned PPO), "paco", "moore", and the
algorithm of any trainer that takes several contexts. Each is trained as long as one source, which
is known beforehand, as in the paper; trainings that go on are transfer data (`transfers`).

A baseline grows in a folder; interrupted at any time it goes on there. Its evaluation plays the
episodes of the transfer matrix of the same seed, and its training has the seed of the source after
the last, so it is none of theirs.

Notation (shapes): N contexts, E episodes.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.engine import lazy as engine
from mbtl.engine.world_trainer import WorldTrainer
from mbtl.errors import InvalidInput, written
from mbtl.files import claimed_folder, whole_file
from mbtl.seeds import MATRIX_TRIAL, PER_TARGET, episode_seeds, evaluation_seeds, training_seed
from mbtl.trainers.contract import Progress, Trainer, recipe_of
from mbtl.zoo.benchmark.npz import read_npz, read_text, text_array, write_npz
from mbtl.zoo.benchmark.provenance import here
from mbtl.zoo.benchmark.shipped import data_folder, seed_files

FOLDER = "multitask"


@dataclass(frozen=True, eq=False)
class MultiTask:
    """One method on one CMDP.

    Attributes:
        returns: (S, N) mean raw return per seed and context.
        std: (S, N) standard deviation over episodes, with n - 1 (older files: n); 0 of one.
        provenance: one record per seed.
    """

    returns: Array
    std: Array
    provenance: tuple[Mapping[str, Any], ...]


def load_multitask(cmdp: str, *, folder: str | Path | None = None) -> dict[str, MultiTask]:
    """Methods stored for a CMDP, seeds stacked in order; empty if there are none.

    Args:
        cmdp: CMDP id.
        folder: where to look instead of the package data.
    """
    place = data_folder() / FOLDER if folder is None else Path(folder)
    methods = {
        name.removeprefix(f"{cmdp}-"): files
        for name, files in seed_files(place).items()
        if name.startswith(f"{cmdp}-")
    }
    return {method: _stack(files) for method, files in methods.items()}


def save_multitask(
    returns: Array,
    std: Array,
    provenance: Mapping[str, Any],
    folder: str | Path,
    cmdp: str,
    method: str,
    seed: int,
) -> Path:
    """Write one seed of one method, (N,) returns and standard deviations, as float32.

    Raises:
        StorageError: the place cannot be written.
    """
    place = Path(folder)
    with written(place):
        place.mkdir(parents=True, exist_ok=True)
    path = multitask_file(place, cmdp, method, seed)
    write_npz(
        path,
        {
            "returns": np.asarray(returns, dtype=np.float32),
            "std": np.asarray(std, dtype=np.float32),
            "provenance": text_array(provenance),
        },
    )
    return path


def multitask_file(folder: Path, cmdp: str, method: str, seed: int) -> Path:
    """Where `save_multitask` writes."""
    return folder / f"{cmdp}-{method}-seed{seed}.npz"


def read_multitask(path: Path) -> MultiTask:
    """One file, as a method of one seed."""
    return _stack({0: path})


def _stack(files: Mapping[int, Path]) -> MultiTask:
    parts = [read_npz(files[seed]) for seed in sorted(files)]
    return MultiTask(
        np.stack([part["returns"].astype(np.float64) for part in parts]),
        np.stack([part["std"].astype(np.float64) for part in parts]),
        tuple(read_text(part["provenance"], "provenance") for part in parts),
    )


# ---- training one ----------------------------------------------------------------------------


Method = Literal["ppo", "paco", "moore"]

OnStep = Callable[[int, int, str], None]
"""Called with (done, total, a note)."""

_TOGETHER = 10
"""Contexts evaluated at once in a simulator, between two signs of life."""
_JUDGED = 2
"""Episodes per context where a policy is judged on the way and they cost next to nothing."""
_MOST, _LEAST = 50, 5
"""How often a policy is judged on all contexts, which is to cost no more than its training."""


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

    def decides(self, seed: int) -> dict[str, Any]:
        """What a folder must have been begun with; more episodes need no other policy."""
        decides = {**self.problem, "seed": seed, **self.settings["recipe"]}
        del decides["eval_episodes"]
        return decides

    def policy(self, own: int, folder: Path, on_step: OnStep) -> tuple[Any, dict[str, Any]]:
        """Trained now or by an interrupted run, and by which code and how long that was."""
        done = folder / "trained.json"
        if done.is_file():
            trained = json.loads(done.read_text("utf-8"))
            return self.trainer.load(folder / "policy"), {"training": trained}

        def on_progress(progress: Progress) -> None:
            note = " ".join(f"{k} {v:.2f}" for k, v in progress.metrics.items())
            on_step(progress.step, progress.total, note)

        begin, origin = time.process_time(), here()
        state = folder / "training.npz"
        policy = self.trainer.train(self.contexts, own, state=state, on_progress=on_progress).policy
        trained = {"train_seconds_of_last_run": round(time.process_time() - begin, 1), **origin}
        (folder / "policy").mkdir(exist_ok=True)
        self.trainer.save(policy, folder / "policy")
        with whole_file(done) as file:
            file.write(json.dumps(trained).encode())
        state.unlink(missing_ok=True)
        return policy, {"training": trained}

    def played(self, policy: Any, seeds: Sequence[int], on_step: OnStep) -> Array:
        """(N, E) returns."""
        rows, n = [], len(self.contexts)
        for first in range(0, n, _TOGETHER):
            on_step(self.length, self.length, f"evaluated on {first} of {n} contexts")
            some = slice(first, first + _TOGETHER)
            rows.append(self.trainer.evaluate(policy, self.contexts[some], seeds[some]))
        return np.concatenate(rows)


@dataclass(frozen=True)
class InJax:
    """Vectorised: context-conditioned PPO, PaCo or MOORE; the best of its evaluations counts.

    CartPole and Pendulum have recipes of their own; every other world is learnt by that of one
    source, its copies spread over the contexts.

    Attributes:
        trainer: of one source; gives the dynamics, and the recipe where there is none for many.
        contexts: the N contexts.
        method: which of the three.
        length: environment steps, over all contexts together.

    Raises:
        InvalidInput: the trainer does not learn by PPO.
    """

    trainer: WorldTrainer
    contexts: Sequence[Context]
    method: Method
    length: int

    def __post_init__(self) -> None:
        if (algorithm := self.trainer.algorithm) != "PPO":
            raise InvalidInput(
                f"multi-task methods learn by PPO, got a recipe of {algorithm}; choose another "
                "--preset"
            )

    @property
    def settings(self) -> dict[str, Any]:
        """What decides the numbers, apart from the seed; JSON-able."""
        one = self._problem()
        every = {} if one.every is None else {"checkpoint_every": one.every}
        return {
            "environment": repr(one.world),
            "recipe": one.recipe.record,
            "contexts": _digest(one.params),
            "timesteps": self.length,
            "episodes": self.trainer.eval_episodes,
            "evaluation_seeds": PER_TARGET,
            "checkpoint_episodes": one.judged,
            **every,
        }

    def decides(self, seed: int) -> dict[str, Any]:
        """What a folder must have been begun with."""
        return {**self.settings, "seed": seed}

    def policy(self, own: int, folder: Path, on_step: OnStep) -> tuple[Any, dict[str, Any]]:
        """The best weights of a training that is kept in the folder, and what is said of it."""
        one, begin = self._problem(), time.monotonic()

        def on_block(block: Any) -> None:
            on_step(block.steps, block.total, f"return {block.training.latest_return[0]:.0f}")

        training = engine.train(
            one.world,
            one.recipe,
            [own],
            one.sets,
            self.length,
            on_block=on_block,
            checkpoint_every=one.every,
            checkpoint_episodes=one.judged * len(self.contexts),
            saved=engine.SavedTraining(folder / "training.npz"),
        )
        return training.best, {
            "trainer": "mbtl-jax-multitask",
            "steps": int(training.updates) * one.recipe.update_length,
            "checkpoint": "best",
            "checkpoint_return": float(training.best_return[0]),
            "train_seconds_of_last_run": round(time.monotonic() - begin, 1),
        }

    def played(self, policy: Any, seeds: Sequence[int], on_step: OnStep) -> Array:
        """(N, E) returns."""
        from mbtl.engine.worlds import context_of  # starts jax

        one = self._problem()
        each = episode_seeds(seeds, len(self.contexts), self.trainer.eval_episodes)
        seen, actor = context_of(one.sets, 0), engine.actor_of(policy)
        activation = one.recipe.activation
        returns: Array = engine.evaluate(one.world, actor, seen, each, activation=activation)[0]
        return returns

    def _problem(self) -> _Problem:
        world, params = self.trainer.problem(self.contexts)
        n = len(self.contexts)
        recipe = engine.multitask_recipe(self.method, self.trainer.learner, world, n)
        sets = engine.in_sets(recipe, params, n)
        if engine.own_recipe(world) is not None:
            return _Problem(world, recipe, params, sets, _JUDGED, None)
        once = n * int(world.decisions(params))
        every = min(max(once, math.ceil(self.length / _MOST)), math.ceil(self.length / _LEAST))
        return _Problem(world, recipe, params, sets, 1, every)


class _Problem(NamedTuple):
    """What is trained and judged.

    Attributes:
        world: the dynamics.
        recipe: hyper-parameters.
        params: of the N contexts.
        sets: the same, as a training of one policy takes them.
        judged: episodes per context of an evaluation on the way.
        every: environment steps between two of these; None: each 2 % of the training.
    """

    world: Any
    recipe: Any
    params: Any
    sets: Any
    judged: int
    every: int | None


def train_on_all(
    job: InSimulator | InJax, seed: int, folder: Path, on_step: OnStep
) -> tuple[Array, Array, dict[str, Any]]:
    """(N,) mean returns of the policy of one seed, their deviations, and a JSON-able record.

    Raises:
        InvalidInput: the folder holds something else.
        StorageError: it cannot be written, or another process works there.
        TrainingFailed: the training failed.
    """
    own = training_seed(seed, MATRIX_TRIAL, len(job.contexts))
    with claimed_folder(folder, job.decides(seed), "a multi-task policy"):
        policy, trained = job.policy(own, folder, on_step)
    seeds = evaluation_seeds(seed, MATRIX_TRIAL, range(len(job.contexts)))
    returns = job.played(policy, seeds, on_step)
    record = {**job.settings, "seed": seed, "training_seed": own, **trained}
    spread = returns.std(axis=1, ddof=min(1, returns.shape[1] - 1))
    return returns.mean(axis=1), spread, record


def _digest(params: Any) -> str:
    """Tells other contexts, or other features shown, apart."""
    parts = [np.ascontiguousarray(x, dtype=np.float64) for x in params]
    text = b"".join(str(x.shape).encode() + x.tobytes() for x in parts)
    return hashlib.sha256(text).hexdigest()[:16]
