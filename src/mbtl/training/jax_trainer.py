"""The jax engine as a trainer of a study, and of whole transfer matrices.

Nothing of jax is imported before a training or evaluation, so the record can be made, printed and
sent to another process anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mbtl.arrays import Array
from mbtl.checkpoints import Checkpoint, shares_of
from mbtl.contexts import Context
from mbtl.portfolio import MLPPolicy
from mbtl.seeds import episode_seed
from mbtl.trainer import OnProgress, Progress
from mbtl.training.mlp_trainer import MLPTrainer

ALGORITHMS = ("PPO", "A2C", "DQN")

_COUNTS = ("timesteps", "eval_episodes", "checkpoint_episodes")

Problem = Callable[[Sequence[Context]], tuple[Any, Any]]
"""contexts -> (`mbtl.training.jax.Environment`, its parameters with one leading axis)."""


@dataclass(frozen=True)
class JaxTrainer(MLPTrainer):
    """Trains policies with the jax engine (`mbtl.trainer.Trainer`), one or many at once.

        trainer = get_cmdp("cartpole-length", engine="jax").trainer_for("full")
        policy = trainer.train({"length": 0.5}, seed=0)
        returns = trainer.evaluate(policy, space.contexts, seed=1)      # (n_targets, 100)

    Attributes:
        problem: contexts -> environment and parameters; a function of a module, or a record.
        timesteps: environment steps of one training, rounded up to whole updates.
        algorithm: "PPO", "A2C" or "DQN".
        recipe_name: named hyper-parameters of the algorithm, e.g. "sb3" or "fast".
        hyperparameters: fields of the recipe that differ from the named one.
        eval_episodes: episodes per target in `evaluate`.
        checkpoint: "final" weights, or the "best" of periodic evaluations on the own context. The
            best cannot change once it has the largest return there is, so training ends there.
        checkpoint_every: environment steps between those evaluations; default 2 % of `timesteps`.
        checkpoint_episodes: deterministic episodes of each.

    Raises:
        InvalidInput: a number is not positive, or `checkpoint` is neither "final" nor "best".
        UnknownName: no such algorithm.
    """

    problem: Problem
    _: KW_ONLY
    timesteps: int
    algorithm: str = "PPO"
    recipe_name: str = "fast"
    hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    eval_episodes: int = 100
    checkpoint: Literal["final", "best"] = "best"
    checkpoint_every: int | None = None
    checkpoint_episodes: int = 10

    def __post_init__(self) -> None:
        object.__setattr__(self, "hyperparameters", dict(self.hyperparameters or {}))
        self._check("jax engine", ALGORITHMS, _COUNTS)

    @property
    def lanes(self) -> int:
        """Policies that are best trained together here.

        All on an accelerator. On a CPU one PPO program already keeps a core busy, and a policy
        trained alone is, bit for bit, the one that a study trains; the small steps of the other
        algorithms need company.
        """
        import mbtl.training.jax as engine

        if not engine.on_cpu():
            return 1 << 20
        return 1 if self.algorithm == "PPO" else 25

    @property
    def update_length(self) -> int:
        """Environment steps of one update."""
        return int(self._recipe().steps_per_update)

    def train_many(
        self,
        contexts: Sequence[Context],
        seeds: Sequence[int],
        on_progress: OnProgress | None = None,
        *,
        keep: Sequence[str] = ("best", "final"),
        partial: Path | None = None,
    ) -> dict[str, list[MLPPolicy]]:
        """Train one policy per (context, seed), all in one compiled program.

        Args:
            contexts: P sources; repeat one to train it with several seeds.
            seeds: P training seeds.
            on_progress: told steps of one policy, and the mean return of the latest evaluations.
            keep: names of checkpoints (`mbtl.checkpoints`); without "final" a training may need
                fewer steps.
            partial: file in which to save the training now and then, and from which to go on if it
                is there. Remove it when the policies are safe.

        Returns:
            P policies under each name of `keep`.
        """
        import mbtl.training.jax as engine

        env, params = self.problem(contexts)
        recipe, marks = self._recipe(), shares_of(keep)
        saved = engine.SavedTraining(partial)

        def on_block(block: engine.Block) -> None:
            if on_progress is not None:
                latest = float(np.mean(block.training.latest_return))
                on_progress(Progress(block.steps, block.total, {"episode_return": latest}))
            saved.save(block.training)

        training = engine.train(
            env,
            recipe,
            seeds,
            params,
            self.timesteps,
            on_block=on_block,
            checkpoint_every=self.checkpoint_every,
            checkpoint_episodes=self.checkpoint_episodes,
            only_best="final" not in keep,
            marks=marks,
            resume=saved.load(lambda: engine.start(env, recipe, seeds, params, marks=marks)),
        )
        return {
            name: engine.export_policies(
                env,
                engine.weights_of(training, Checkpoint.named(name), marks),
                recipe.activation,
            )
            for name in keep
        }

    def untrained(self, context: Context) -> MLPPolicy:
        """A policy as a training begins with it (`mbtl.trainer.RehearsingTrainer`)."""
        import mbtl.training.jax as engine

        env, params = self.problem([context])
        recipe = self._recipe()
        weights = engine.start(env, recipe, [0], params).state.weights
        return engine.export_policies(env, weights, recipe.activation)[0]

    def evaluate_many(
        self, policies: Sequence[MLPPolicy], contexts: Sequence[Context], seed: int
    ) -> Array:
        """(P, n_targets, eval_episodes) returns of policies of one shape; see `evaluate`."""
        import mbtl.training.jax as engine

        env, params = self.problem(contexts)
        seeds = [episode_seed(seed, episode) for episode in range(self.eval_episodes)]
        actors = engine.import_actors(list(policies))
        activation = policies[0].activation
        return engine.evaluate(
            env, actors, params, engine.episode_noise(env, seeds), activation=activation
        )

    def reference_rows(self, contexts: Sequence[Context], seed: int) -> dict[str, Array]:
        """See `mbtl.trainer.ReferenceTrainer`."""
        import mbtl.training.jax as engine

        env, params = self.problem(contexts)
        seeds = [episode_seed(seed, episode) for episode in range(self.eval_episodes)]
        return engine.reference_returns(env, params, seeds)

    @property
    def recipe(self) -> dict[str, Any]:
        """What decides the policies and their returns, JSON-able; not the place or speed."""
        return {
            "trainer": "mbtl-jax",
            "algorithm": self.algorithm,
            "recipe": self.recipe_name,
            "hyperparameters": dict(sorted(self.hyperparameters.items())),
            "timesteps": self.timesteps,
            "checkpoint": self.checkpoint,
            "checkpoint_every": self.checkpoint_every,
            "checkpoint_episodes": self.checkpoint_episodes,
            "eval_episodes": self.eval_episodes,
        }

    # ---- inside ------------------------------------------------------------------------------

    def _recipe(self) -> Any:
        import mbtl.training.jax as engine

        return self._changed(engine.recipe_named(self.algorithm, self.recipe_name))
