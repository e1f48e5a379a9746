"""The traffic twins as a trainer of a study, and of whole transfer matrices.

Nothing of jax is imported before a training or evaluation, as in `mbtl.training.jax_trainer`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from mbtl.arrays import Array
from mbtl.checkpoints import Checkpoint, shares_of
from mbtl.contexts import Context
from mbtl.errors import InvalidInput, unknown_name
from mbtl.portfolio import MLPPolicy
from mbtl.seeds import episode_seed
from mbtl.trainer import OnProgress, Progress
from mbtl.training.mlp_trainer import MLPTrainer

ALGORITHMS = ("TRPO", "PPO")

_CPU_LANES = 25
"""Sources trained together on a CPU where contexts can be mixed: enough to fill its vectors."""
_CHECKPOINTS, _EACH = 20, 2
"""Evaluations of a policy for all contexts, and episodes of each on every context."""
Acting = Literal["sampled", "mean"]

_REFERENCES: Mapping[str, Literal["random", "none"]] = {
    "random_actions": "random",
    "unguided": "none",
}
"""How agents act in the rows without a policy."""

Problem = Callable[[Sequence[Context]], tuple[Any, Sequence[Any]]]
"""contexts -> (`mbtl.training.jax.traffic.twin.Twin`, the parameters of each)."""


@dataclass(frozen=True)
class TwinTrainer(MLPTrainer):
    """Trains policies in a traffic twin (`mbtl.trainer.Trainer`); returns are scores.

        trainer = get_cmdp("ring-acc", engine="jax").trainer_for("paper")
        policy = trainer.train({"hold": 5.0}, seed=0)
        scores = trainer.evaluate(policy, space.contexts, seed=1)      # (n_targets, 50), m/s

    Attributes:
        problem: contexts -> twin and parameters; a function of a module, or a record.
        episodes: of one training, rounded up to whole updates.
        algorithm: "TRPO" or "PPO".
        recipe_name: named hyper-parameters of the algorithm.
        hyperparameters: fields of the recipe that differ from the named one.
        eval_episodes: episodes per target in `evaluate`.
        acting: in all evaluations, "sampled" actions (as the paper's), or the "mean" ones.
        checkpoint: "final" weights, or the "best" of periodic evaluations on the own context.
        checkpoint_every: episodes between those evaluations; default 2 % of `episodes`.
        checkpoint_episodes: episodes of each.
        reward: what training is rewarded by, a name that the twin knows; None: by the CMDP's own
            reward. It changes no score.

    Raises:
        InvalidInput: a number is not positive, or `checkpoint` is neither "final" nor "best".
        UnknownName: no such algorithm, or way to act.
    """

    problem: Problem
    _: KW_ONLY
    episodes: int
    algorithm: str = "TRPO"
    recipe_name: str = "paper"
    hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    eval_episodes: int = 50
    acting: Acting = "sampled"
    checkpoint: Literal["final", "best"] = "best"
    checkpoint_every: int | None = None
    checkpoint_episodes: int = 10
    reward: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "hyperparameters", dict(self.hyperparameters or {}))
        self._check(
            "traffic twins", ALGORITHMS, ("episodes", "eval_episodes", "checkpoint_episodes")
        )
        if self.acting not in get_args(Acting):
            raise unknown_name("way to act", self.acting, get_args(Acting))

    @property
    def lanes(self) -> int:
        """Policies that are best trained together here.

        One where contexts differ in their decisions, as each is a program of its own then.
        """
        from mbtl.training.jax import on_cpu

        twin, _ = self.problem([])
        if not twin.mixes:
            return 1
        return _CPU_LANES if on_cpu() else 1 << 20

    @property
    def update_length(self) -> int:
        """Episodes of one update."""
        return int(self._recipe().n_episodes)

    def train_many(
        self,
        contexts: Sequence[Context],
        seeds: Sequence[int],
        on_progress: OnProgress | None = None,
        *,
        keep: Sequence[str] = ("best", "final"),
        partial: Path | None = None,
    ) -> dict[str, list[MLPPolicy]]:
        """Train one policy per (context, seed).

        Args:
            contexts: P sources; repeat one to train it with several seeds.
            seeds: P training seeds.
            on_progress: told episodes of one policy, and the mean score of the latest evaluations.
            keep: names of checkpoints (`mbtl.checkpoints`).
            partial: file in which to save the trainings now and then, and from which to go on if it
                is there. Remove it when the policies are safe.

        Returns:
            P policies under each name of `keep`.
        """
        import mbtl.training.jax as engine
        from mbtl.training.jax.traffic.learning import start, train

        twin, params = self._lessons(contexts)
        recipe, marks = self._recipe(), shares_of(keep)
        saved = engine.SavedTraining(partial)
        policies: dict[str, list[MLPPolicy]] = {name: [] for name in keep}
        groups = _groups(twin, seeds, params)
        for number, (some, each) in enumerate(groups):
            last = number == len(groups) - 1

            def on_block(block: engine.Block, number: int = number, last: bool = last) -> None:
                if on_progress is not None:
                    latest = float(np.mean(block.training.latest_return))
                    on_progress(Progress(block.steps, block.total, {"score": latest}, "episodes"))
                done = block.steps == block.total and not last
                saved.save(block.training, number=number, done=done)

            fresh = functools.partial(start, twin, recipe, some, each, marks)
            training = train(
                twin,
                recipe,
                some,
                each,
                self.episodes,
                on_block=on_block,
                checkpoint_every=self.checkpoint_every,
                checkpoint_episodes=self.checkpoint_episodes,
                acting=self.acting,
                marks=marks,
                resume=saved.load(fresh, number=number),
            )
            for name in keep:
                weights = engine.weights_of(training, Checkpoint.named(name), marks)
                policies[name] += engine.export_policies(twin, weights, recipe.activation)
        return policies

    def train_on_all(
        self,
        contexts: Sequence[Context],
        seed: int,
        on_progress: OnProgress | None = None,
        *,
        partial: Path | None = None,
    ) -> MLPPolicy:
        """Train one policy for all contexts; each episode of an update is in another of them.

        It is judged on all of them 20 times, two episodes each: of few contexts or for short
        trainings that is most of the work.

        Args:
            contexts: of which to draw.
            seed: training seed.
            on_progress: told episodes, and the mean score on all contexts.
            partial: file in which to save the training now and then, and from which to go on if it
                is there. Remove it when the policy is safe.

        Raises:
            InvalidInput: there are no contexts.
        """
        import mbtl.training.jax as engine
        from mbtl.training.jax.traffic.learning import start
        from mbtl.training.jax.traffic.multitask import train_on_all

        if not contexts:
            raise InvalidInput("multi-task training takes at least one context, got none")
        saved = engine.SavedTraining(partial)

        def on_block(block: engine.Block) -> None:
            if on_progress is not None:
                score = float(block.training.latest_return[0])
                on_progress(Progress(block.steps, block.total, {"score": score}, "episodes"))
            saved.save(block.training)

        twin, params = self._lessons(contexts)
        recipe = self._recipe()
        training = train_on_all(
            twin,
            recipe,
            seed,
            params,
            self.episodes,
            checkpoints=_CHECKPOINTS,
            checkpoint_episodes=_EACH,
            acting=self.acting,
            on_block=on_block,
            resume=saved.load(lambda: start(twin, recipe, [seed], params[0])),
        )
        weights = training.best if self.checkpoint == "best" else training.state.weights
        return engine.export_policies(twin, weights, recipe.activation)[0]

    def untrained(self, context: Context) -> MLPPolicy:
        """A policy as a training begins with it (`mbtl.trainer.RehearsingTrainer`)."""
        import mbtl.training.jax as engine
        from mbtl.training.jax.traffic.learning import start

        twin, params = self.problem([context])
        recipe = self._recipe()
        weights = start(twin, recipe, [0], params[0]).state.weights
        return engine.export_policies(twin, weights, recipe.activation)[0]

    def evaluate_many(
        self, policies: Sequence[MLPPolicy], contexts: Sequence[Context], seed: int
    ) -> Array:
        """(P, n_targets, eval_episodes) scores of policies of one shape."""
        from mbtl.training.jax.traffic.episodes import import_actor, scores

        twin, params = self.problem(contexts)
        actor = import_actor(list(policies))
        seeds = [episode_seed(seed, episode) for episode in range(self.eval_episodes)]
        same = np.tile(np.array(seeds, dtype=np.uint32), (len(policies), 1))
        activation = policies[0].activation
        rows = [
            np.asarray(scores(twin, activation, self.acting, actor, same, one, twin.decisions(one)))
            for one in params
        ]
        return np.stack(rows, axis=1).astype(np.float64)

    def reference_rows(self, contexts: Sequence[Context], seed: int) -> dict[str, Array]:
        """See `mbtl.trainer.ReferenceTrainer`."""
        import jax.numpy as jnp

        from mbtl.training.jax.traffic.episodes import Actor, scores

        twin, params = self.problem(contexts)
        nobody = Actor((), jnp.zeros((1, 1)))
        seeds = [[episode_seed(seed, episode) for episode in range(self.eval_episodes)]]
        same = np.array(seeds, dtype=np.uint32)
        return {
            name: np.stack(
                [
                    np.asarray(scores(twin, "tanh", how, nobody, same, one, twin.decisions(one)))[0]
                    for one in params
                ]
            ).astype(np.float64)
            for name, how in _REFERENCES.items()
        }

    @property
    def recipe(self) -> dict[str, Any]:
        """What decides the policies and their scores, JSON-able; not the place or speed."""
        return {
            "trainer": "mbtl-twin",
            "algorithm": self.algorithm,
            "recipe": self.recipe_name,
            "hyperparameters": dict(sorted(self.hyperparameters.items())),
            "episodes": self.episodes,
            "acting": self.acting,
            "checkpoint": self.checkpoint,
            "checkpoint_every": self.checkpoint_every,
            "checkpoint_episodes": self.checkpoint_episodes,
            "eval_episodes": self.eval_episodes,
            **({} if self.reward is None else {"reward": self.reward}),
        }

    @property
    def recipe_on_all(self) -> dict[str, Any]:
        """As `recipe`, of `train_on_all`."""
        own = {"contexts": "uniform, one per episode", "checkpoint_every": f"1/{_CHECKPOINTS}"}
        return {**self.recipe, **own, "checkpoint_episodes": f"{_EACH} per context"}

    def _lessons(self, contexts: Sequence[Context]) -> tuple[Any, Sequence[Any]]:
        """The twin as it teaches, and the parameters of each context."""
        twin, params = self.problem(contexts)
        if self.reward is None:
            return twin, params
        known = getattr(twin, "rewards", ())
        if self.reward not in known:
            raise unknown_name("reward of this twin", self.reward, known)
        return replace(twin, reward=self.reward), params

    def _recipe(self) -> Any:
        import mbtl.training.jax  # noqa: F401  first: flags of jax
        from mbtl.training.jax.traffic.recipes import twin_recipe_named

        return self._changed(twin_recipe_named(self.algorithm, self.recipe_name))


def _groups(twin: Any, seeds: Sequence[int], params: Sequence[Any]) -> list[tuple[Any, Any]]:
    """(seeds, parameters) of the trainings that go together."""
    if not twin.mixes:
        return [([seed], one) for seed, one in zip(seeds, params, strict=True)]
    import jax
    import jax.numpy as jnp

    return [(list(seeds), jax.tree.map(lambda *x: jnp.stack(x), *params))]
