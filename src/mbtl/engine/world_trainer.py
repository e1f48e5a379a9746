"""The worlds in jax as a trainer of a study, and of whole transfer matrices.

Nothing of jax is imported before a training or evaluation, so the record can be made, printed and
sent to another process anywhere.

How long a training of a given length may become nobody knows beforehand, so its learning rate falls
slowly, and to zero on a branch whose end is the policy: it is a finished one, and the training can
still go on (`mbtl.engine.learners.growing`). All that decides its future is in its state.
A whole training follows the recipe: its length is known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.engine import lazy as engine
from mbtl.errors import InvalidInput, check_known, unknown_name
from mbtl.portfolio import MLPPolicy
from mbtl.score import RANDOM_ACTIONS, SCORE
from mbtl.seeds import episode_seeds
from mbtl.trainers.contract import (
    Ability,
    OnProgress,
    Progress,
    Trained,
    check_asked,
    check_settings,
    checked_returns,
    even_groups,
)

BY_STEPS = ("PPO", "A2C", "DQN")
"""Algorithms that learn every few steps; a training is as many `timesteps`."""
BY_EPISODES = ("TRPO", "PPO", "A2C", "DQN")
"""Algorithms that learn from whole episodes; a training is as many `episodes`."""

_COUNTS = ("eval_episodes", "checkpoint_episodes")
_OPTIONAL_COUNTS = ("timesteps", "episodes", "checkpoint_every")

_JUDGED = 20
"""Evaluations in a unit of a training of a given length, where the recipe keeps the best."""
_CPU_LANES = 25
"""Sources trained together on a CPU where one of them would not keep it busy."""
_SPENT, _FROM, _BRANCH, _SEED = "spent", "from", "branch", "seed"
_BEFORE, _WHOLE = "before", "whole"
"""Kept with the state of a training: updates spent before this stage, where on the trunk it began,
and the branch of the stage before; whose it is; updates of what it was tuned from, as its own; and
those of one unit."""

Problem = Callable[[Sequence[Context]], tuple[Any, Any]]
"""contexts -> (`mbtl.engine.World`, its parameters with one leading axis)."""


@dataclass(frozen=True)
class WorldTrainer:
    """Trains policies in a world (`mbtl.trainers.Trainer`), one or many at once.

        trainer = get_cmdp("cartpole-length", engine="jax").trainer_for("full")
        policy = trainer.train([{"length": 0.5}], seed=0).policy
        returns = trainer.evaluate(policy, space.contexts, range(space.n))  # (n_targets, 100)

    Attributes:
        problem: contexts -> world and parameters; a function of a module, or a record.
        timesteps: environment steps of one training, rounded up to whole updates; or
        episodes: of one training, likewise.
        algorithm: "PPO", "A2C" or "DQN"; by whole episodes "TRPO", too.
        recipe_name: named hyper-parameters of the algorithm, e.g. "sb3", "fast" or "paper".
        hyperparameters: fields of the recipe that differ from the named one.
        eval_episodes: episodes per target in `evaluate`.
        acting: in all evaluations, the "mean" actions, or "sampled" ones; None: mean where steps
            are counted, sampled where episodes are, as in the papers. DQN always takes the best
            action, since values are no chances.
        checkpoint: "final" weights, or the "best" of periodic evaluations on the own context. The
            best cannot change once it has the largest return there is, so training ends there.
        checkpoint_every: steps or episodes between those evaluations; default 2 % of the training.
        checkpoint_episodes: episodes of each.
        reward: what training is rewarded by, a name that the world knows; None: by its own reward.
            It changes no score.
        actions: what training advises, a name that the world knows; None: the world's own actions,
            which the policies use in either case.

    Raises:
        InvalidInput: a number is not positive, there is not one of `timesteps` and `episodes`, or
            `checkpoint` is neither "final" nor "best".
        UnknownName: no such algorithm, or way to act.
    """

    problem: Problem
    _: KW_ONLY
    timesteps: int | None = None
    episodes: int | None = None
    algorithm: str = "PPO"
    recipe_name: str | None = None
    hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    eval_episodes: int = 100
    acting: Literal["sampled", "mean"] | None = None
    checkpoint: Literal["final", "best"] = "best"
    checkpoint_every: int | None = None
    checkpoint_episodes: int = 10
    reward: str | None = None
    actions: str | None = None

    policy_format = "mlp"

    def __post_init__(self) -> None:
        by_steps, algorithm = self.episodes is None, self.algorithm
        for name, value in {
            "hyperparameters": dict(self.hyperparameters or {}),
            "recipe_name": self.recipe_name
            or ("fast" if by_steps or algorithm == "A2C" else "paper"),
            "acting": self.acting or ("mean" if by_steps else "sampled"),
        }.items():
            object.__setattr__(self, name, value)
        check_settings(self, _COUNTS, _OPTIONAL_COUNTS)
        algorithms = BY_STEPS if by_steps else BY_EPISODES
        kind = "jax engine" if by_steps else "traffic twins"
        check_known(f"algorithm of the {kind}", self.algorithm, algorithms)

    # ---- what it is --------------------------------------------------------------------------

    @property
    def on_sets(self) -> dict[str, str]:
        """How the recipe of one policy for several contexts differs."""
        best, wide = f"the best of about {_JUDGED} evaluations a unit", "twice as wide as `hidden`"
        always = {
            "schedule": "falling slowly, and to zero along a last fifth",
            "checkpoint": best if self._judges else "final",
        }
        if self._by_ppo or self.episodes is not None:
            return always | {
                "contexts": "uniform, one per episode; by TRPO four, or all, in an update",
                "layers": f"{wide}, by PPO that counts steps in worlds of no own recipe",
            }
        return always | {
            "contexts": "uniform, one per episode",
            "copies": "16 or more of A2C; of DQN one per context, and gradient steps per copy",
            "layers": wide,
        }

    @property
    def _by_ppo(self) -> bool:
        """Whether it learns by PPO that counts steps, whose latest weights are good ones."""
        return self.algorithm == "PPO" and self.episodes is None

    @property
    def _judges(self) -> bool:
        """Whether a training of a given length keeps the best of its evaluations."""
        return self.checkpoint == "best" and not self._by_ppo

    @property
    def unit(self) -> str:
        """What is counted, "timesteps" or "episodes"."""
        return "timesteps" if self.episodes is None else "episodes"

    @property
    def length(self) -> int:
        """Timesteps or episodes of one training."""
        return int(getattr(self, self.unit))

    @property
    def update_length(self) -> int:
        """Timesteps or episodes of one update."""
        return int(self.learner.update_length)

    @property
    def learner(self) -> Any:
        """The recipe in the engine, with this trainer's `hyperparameters`.

        Raises:
            UnknownName: no such recipe, or it has no such hyper-parameter.
        """
        named = engine.recipe_named(self.algorithm, str(self.recipe_name), self.unit)
        for name in self.hyperparameters:
            check_known(f"hyperparameter of {self.algorithm}", name, named.record)
        return replace(named, **self.hyperparameters)

    @property
    def recipe(self) -> dict[str, Any]:
        """What decides the policies and their returns, JSON-able; not the place or speed."""
        by_steps = self.unit == "timesteps"
        return {
            "trainer": "mbtl-jax" if by_steps else "mbtl-twin",
            "algorithm": self.algorithm,
            "recipe": self.recipe_name,
            "hyperparameters": dict(sorted(self.hyperparameters.items())),
            self.unit: self.length,
            **({} if by_steps and self.how == "mean" else {"acting": self.how}),
            "checkpoint": self.checkpoint,
            "checkpoint_every": self.checkpoint_every,
            "checkpoint_episodes": self.checkpoint_episodes,
            "eval_episodes": self.eval_episodes,
            **({} if self.reward is None else {"reward": self.reward}),
            **({} if self.actions is None else {"actions": self.actions}),
        }

    @property
    def takes(self) -> frozenset[Ability]:
        """All there is; no state where no file can hold it."""
        storable = getattr(self.problem, "storable", True)
        stored: set[Ability] = {"state", "inherit", "resume"} if storable else set()
        return frozenset({*stored, "sets", "start", "length"})

    def why_not(self, ability: Ability) -> str:
        """What the world cannot do."""
        return "its simulators live in one process; choose another --engine"

    @property
    def whole(self) -> int:
        """Timesteps of one training, whole updates; or its episodes."""
        if self.episodes is not None:
            return self.episodes
        unit = self.update_length
        return -(-self.length // unit) * unit

    @property
    def counts(self) -> Literal["steps", "episodes"]:
        """What `whole` counts."""
        return "steps" if self.episodes is None else "episodes"

    @property
    def lanes(self) -> int:
        """Policies that are best trained together here.

        As many as the problem says, or all on an accelerator. On a CPU one PPO program by steps
        already keeps a core busy, and a policy trained alone is, bit for bit, the one that a study
        trains; the others need company.
        """
        if (own := getattr(self.problem, "lanes", None)) is not None:
            return int(own)
        if not engine.on_cpu():
            return 1 << 20
        return 1 if self._by_ppo else _CPU_LANES

    def groups(self, contexts: Sequence[Context], lanes: int) -> list[int]:
        """Sizes of the groups of consecutive contexts that are trained together."""
        if self.unit == "episodes" and engine.on_cpu():
            world, params = self.problem(contexts)
            if hasattr(world, "groups"):
                return list(world.groups(params, lanes))
        return even_groups(len(contexts), lanes)

    # ---- training ----------------------------------------------------------------------------

    def train(
        self,
        contexts: Sequence[Context],
        seed: int,
        *,
        start: Any = None,
        length: float | None = None,
        done: float = 0.0,
        state: Path | None = None,
        on_progress: OnProgress | None = None,
    ) -> Trained:
        """Train one policy (`mbtl.trainers.Trainer`), up to whole updates.

        A whole training on one context follows the recipe, which may say that the best of periodic
        evaluations counts. A training of a given `length`, and one on several contexts, has a
        learning rate that falls slowly, and to zero along the last fifth of what is asked for
        (`mbtl.engine.learners.growing`). By PPO that counts steps it has the latest weights and
        does not evaluate itself. Else, where the recipe keeps the best, so does it: twenty times a
        unit each context is played once, a single one `checkpoint_episodes` times; its steps do not
        count that, as a specialist's do not. Where it begins with the policy of another one, whose
        state is there, it inherits the latter's critic, optimiser, statistics and learning rate,
        and its actor before it was finished, or the best of its evaluations; else the critic, which
        no policy carries, begins anew.

        On several contexts each episode of an update is in another of them. Where steps are
        counted, its copies of the world take turns in the contexts, and its layers are mostly
        wider; by PPO it is the context-conditioned one of the multi-task baseline.

        Raises:
            InvalidInput: there are no contexts, a hyper-parameter that the recipe does not have, or
                `start` has another shape.
            TrainingFailed: the weights became NaN.
            MissingExtra: jax is not installed.
        """
        check_asked(self, contexts, start, length)
        if length is not None or len(contexts) > 1:
            return self._grow(contexts, seed, start, length or 1.0, done, state, on_progress)
        world, params = lessons = self._lessons(contexts)
        training = self._whole(
            lessons, [seed], state, on_progress, self.checkpoint == "best", start
        )
        weights = training.best if self.checkpoint == "best" else training.state.weights
        policy = engine.export_policies(world, weights, self.learner.activation)[0]
        each = 1 if self.episodes is None else _decisions_of(world, params)
        return Trained(policy, int(training.updates) * self.update_length * each)

    def _whole(
        self,
        lessons: tuple[Any, Any],
        seeds: Sequence[int],
        state: Path | None,
        on_progress: OnProgress | None,
        only_best: bool,
        start: Any = None,
        contexts: Sequence[Context] = (),
    ) -> Any:
        """Trainings as the recipe says, each on one of the contexts."""
        world, params = lessons
        recipe, weights = self._begun(world, self.learner, start)
        metric = "episode_return" if self.episodes is None else "score"

        def on_block(block: Any) -> None:
            if on_progress is not None:
                latest = float(np.mean(block.training.latest_return))
                on_progress(Progress(block.steps, block.total, {metric: latest}, self.counts))

        return engine.train(
            world,
            recipe,
            seeds,
            params,
            self.length,
            on_block=on_block,
            checkpoint_every=self.checkpoint_every,
            checkpoint_episodes=self.checkpoint_episodes,
            acting=self.how,
            only_best=only_best,
            weights=weights,
            saved=_saved(world, state),
            contexts=contexts,
        )

    def _grow(
        self,
        contexts: Sequence[Context],
        seed: int,
        start: Any,
        length: float,
        done: float,
        state: Path | None,
        on_progress: OnProgress | None,
    ) -> Trained:
        """One training of a given length, from where it is."""
        growing = self._growing([contexts], [seed])
        recipe, weights = self._begun(growing.world, growing.recipe, start)
        growing = growing._replace(recipe=recipe)
        n, by_steps, unit = len(contexts), self.episodes is None, int(recipe.update_length)
        file = _saved(growing.world, state)
        each: Any = () if by_steps else _each_of(self.problem, contexts)

        def played(updates: int) -> int:
            many = updates * unit
            if by_steps:
                return many
            if n == 1:
                return many * int(each[0])
            return int(engine.episodes_met(seed, updates, n, unit) @ each)

        def fresh() -> Any:
            return growing.start(weights)

        training = file.load(fresh)
        if training is None or file.notes.get(_SEED) != seed:  # nobody's, or the parent's
            begun = fresh()
            found = file.inherited(begun, best=self.checkpoint == "best")
            training, before = found or (begun, 0)
            before += file.notes.get(_BEFORE, 0)
            before = round(before * growing.whole / file.notes.get(_WHOLE, growing.whole))
            spent = self._updates(done, unit)
            on_trunk = 0 if found else engine.stage(spent)[0]  # its state is lost; schedules go on
            if by_steps and self.algorithm == "DQN":  # its ring is empty, and filled by updates
                before, on_trunk = before + on_trunk, 0
            training = training._replace(updates=training.updates + on_trunk)
            own = {_BEFORE: before, _WHOLE: growing.whole}
            file.notes = {_SPENT: spent, _FROM: int(training.updates), _SEED: seed, **own}
        spent, begin = file.notes[_SPENT], file.notes[_FROM]
        growing = growing._replace(before=file.notes[_BEFORE])
        planned = max(self._updates(length, unit), spent)
        further, branch = engine.stage(planned - spent)
        end = begin + further
        if planned == spent:  # there already; the policy is the one that it had
            branch = file.notes.get(_BRANCH, 0)

        def on_block(block: Any) -> None:
            if on_progress is not None:
                updates = spent + block.steps // unit - begin
                on_progress(Progress(played(updates), played(planned)))
            if block.training.updates <= end:
                file.save(block.training)

        training = growing.along(training, end, on_block)
        file.save(training, done=True)  # whoever is interrupted on the branch begins it again
        weights = growing.end(training, branch, on_block)
        file.notes |= {_SPENT: planned, _FROM: end, _BRANCH: branch}
        file.save(training, done=True)
        return Trained(growing.policies(weights)[0], played(planned))

    def grow_many(
        self,
        sets: Sequence[Sequence[Context]],
        seeds: Sequence[int],
        marks: Sequence[float],
        *,
        parents: Any = None,
        which: Sequence[int] = (),
        parents_on: int = 1,
        trunk: Any = None,
        done: float = 0.0,
        on_progress: OnProgress | None = None,
    ) -> Iterator[tuple[float, list[MLPPolicy], Any]]:
        """Train many policies at once, to each of several lengths.

        Args:
            sets: contexts of each of the P trainings, as many of each.
            seeds: P of them.
            marks: units, rising; each is where a training may end.
            parents: trunks of other trainings to begin with; None: from scratch.
            which: (P,) one of the parents for each.
            parents_on: how many contexts they were trained on.
            trunk: of these trainings, to go on from.
            done: mark that it was left at; those behind it are not trained again.
            on_progress: told steps or episodes of one policy.

        Yields:
            Mark, the P policies there, and the trunk (an `mbtl.engine.learners.Training`),
            whose memory is used again when the next is asked for.
        """
        growing = self._growing(sets, seeds)
        unit = int(growing.recipe.update_length)
        training = growing.start() if trunk is None else trunk
        if parents is not None:
            training = engine.taking_over(training, parents, which)
            theirs = self._updates(
                1.0, int(self._learner_of(growing.world, parents_on).update_length)
            )
            before = round(int(parents.updates) * growing.whole / theirs)  # updates as our own
            growing = growing._replace(before=before)

        def on_block(block: Any) -> None:
            if on_progress is not None:
                on_progress(Progress(block.steps, block.total, {}, self.counts))

        spent = 0
        for mark in marks:
            planned = self._updates(mark, unit)
            (further, branch), spent = engine.stage(planned - spent), planned
            if mark <= done:
                continue
            training = growing.along(training, int(training.updates) + further, on_block)
            weights = growing.end(training, branch, on_block)
            yield mark, growing.policies(weights), training

    def grown_from_scratch(self, sets: Sequence[Sequence[Context]], seeds: Sequence[int]) -> Any:
        """Trainings of `grow_many` before their first update."""
        return self._growing(sets, seeds).start()

    def _growing(self, sets: Sequence[Sequence[Context]], seeds: Sequence[int]) -> Any:
        n = len(sets[0])
        world, params = self._lessons([context for some in sets for context in some])
        recipe = self._learner_of(world, n)
        spread = engine.in_sets(recipe, params, n)
        whole = self._updates(1.0, int(recipe.update_length))
        judged = -(-whole // _JUDGED) if self._judges else 0
        episodes = n if n > 1 else self.checkpoint_episodes
        return engine.Growing(
            world, recipe, list(seeds), spread, whole,
            judged=judged, episodes=episodes, acting=self.how,
        )  # fmt: skip

    def _learner_of(self, world: Any, n: int) -> Any:
        """The recipe of a policy for so many contexts."""
        return self.learner if n == 1 else engine.of_several(self.learner, world, n)

    def _begun(self, world: Any, recipe: Any, start: Any) -> tuple[Any, Any]:
        """The recipe for layers as wide as those of `start`, and its weights; or None."""
        if start is None:
            return recipe, None
        weights = engine.taught(world, start, recipe.activation)
        return engine.as_wide_as(recipe, weights), weights

    def _updates(self, units: float, unit: int) -> int:
        """Whole updates of `unit` steps or episodes that so many units are, rounded up."""
        return -(-round(units * self.whole) // unit)

    def train_many(
        self,
        contexts: Sequence[Context],
        seeds: Sequence[int],
        *,
        keep: Sequence[str] = ("best", "final"),
        state: Path | None = None,
        on_progress: OnProgress | None = None,
    ) -> dict[str, list[MLPPolicy]]:
        """Train one policy per (context, seed), all in one program (`mbtl.trainers.ManyTrainer`).

        Repeat a context to train it with several seeds. `on_progress` is told steps or episodes of
        one policy, and the mean of the latest evaluations; without "final" among what to keep, a
        training may need fewer of them.
        """
        lessons, activation = self._lessons(contexts), self.learner.activation
        best = "final" not in keep
        training = self._whole(lessons, seeds, state, on_progress, best, contexts=contexts)
        kept = {"best": training.best, "final": training.state.weights}
        return {name: engine.export_policies(lessons[0], kept[name], activation) for name in keep}

    def untrained(self, context: Context) -> MLPPolicy:
        """A policy as a training begins with it (`mbtl.trainers.RehearsingTrainer`)."""
        world, params = self._lessons([context])
        recipe = self.learner
        weights = engine.start(world, recipe, [0], params).best
        return engine.export_policies(world, weights, recipe.activation)[0]

    def _lessons(self, contexts: Sequence[Context]) -> tuple[Any, Any]:
        """The world as it teaches, and the parameters of the contexts."""
        world, params = self.problem(contexts)
        asked = ("reward", self.reward, "rewards"), ("set of actions", self.actions, "lessons")
        for what, name, names in asked:
            if name is not None and name not in (known := getattr(world, names, ())):
                raise unknown_name(f"{what} of this world", name, known)
        if self.reward is not None:
            world = replace(world, reward=self.reward)
        return world if self.actions is None else world.lesson(self.actions), params

    # ---- evaluation --------------------------------------------------------------------------

    def evaluate(
        self, policy: MLPPolicy, contexts: Sequence[Context], seeds: Sequence[int] | int
    ) -> Array:
        """Returns without adaptation, (n_targets, eval_episodes).

        Episode e in a context starts from random numbers that follow from the seed given for it:
        the same for every policy, and whatever the other contexts.

        Raises:
            InvalidInput: there is another number of seeds than of contexts.
            TrainingFailed: a return is NaN or infinite.
        """
        returns = self.evaluate_many([policy], contexts, seeds)[0]
        return checked_returns(returns, len(contexts), contexts)

    def evaluate_steps(
        self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int] | int
    ) -> tuple[Array, Array]:
        """As `evaluate`, and how many steps each episode had, both (n_targets, eval_episodes)."""
        found = self._measured([policy], contexts, seeds)
        returns = checked_returns(found["score"][0], len(contexts), contexts)
        if "steps" in found:
            return returns, found["steps"][0]
        return returns, _each_of(self.problem, contexts)[:, None] + np.zeros_like(returns)

    def evaluate_many(
        self, policies: Sequence[MLPPolicy], contexts: Sequence[Context], seeds: Sequence[int] | int
    ) -> Array:
        """(P, n_targets, eval_episodes) returns of policies of one shape; see `evaluate`."""
        return self._measured(policies, contexts, seeds)["score"]

    def _measured(
        self, policies: Sequence[MLPPolicy], contexts: Sequence[Context], seeds: Sequence[int] | int
    ) -> dict[str, Array]:
        """The same for all that the world measures, by name."""
        each = episode_seeds(seeds, len(contexts), self.eval_episodes)
        world, params = self.problem(contexts)
        actor, acts = engine.import_actor(list(policies)), policies[0].activation
        return engine.measured(world, actor, params, each, activation=acts, how=self.how)

    def simulation(self, context: Context) -> Any:
        """One simulation as a Gymnasium environment; None of a world that is no `Solo`."""
        from mbtl.engine.worlds.one import OneSimulation
        from mbtl.engine.worlds.world import Solo

        world, params = self.problem([context])
        return OneSimulation(world, params) if isinstance(world, Solo) else None

    def ways(self, contexts: Sequence[Context]) -> tuple[str, ...]:
        """See `mbtl.trainers.MeasuringTrainer`."""
        world, _ = self.problem(contexts)
        alone = ("unguided",) if world.drives else ()
        return (RANDOM_ACTIONS, *alone, *getattr(world, "ways", ()))

    def measure(
        self,
        policy: Any,
        contexts: Sequence[Context],
        seeds: Sequence[int] | int,
        names: Sequence[str] = (),
    ) -> dict[str, Array]:
        """What the world measures, or its simulators; see `mbtl.trainers.MeasuringTrainer`."""
        world, params = self.problem(contexts)
        each = episode_seeds(seeds, len(contexts), self.eval_episodes)
        problem: Any = self.problem
        alone = hasattr(problem, "make_env") and not hasattr(world, "measures")
        make, score = None, None
        if not isinstance(policy, (str, MLPPolicy)):
            if not callable(policy) or self.simulation(contexts[0]) is None:
                raise InvalidInput(
                    "worlds are played by policies of the engine, by ways that they name and, "
                    "where there is one agent in jax, by functions of an observation, got "
                    f"{type(policy).__name__}; give one of {self.ways(contexts)}"
                )
            make = self.simulation
        elif names and alone and policy != RANDOM_ACTIONS:
            make, score = problem.make_env, getattr(problem, "score", None)
        if make is not None:  # one after another
            from mbtl.envs.references import Controller, played
            from mbtl.envs.rollout import Actor

            who: Any = policy
            if isinstance(policy, MLPPolicy):
                who = Actor(policy, self.how == "sampled")
            elif not isinstance(policy, str):
                who = Actor(Controller(policy))
            return played(make, who, contexts, each, names, score=score, max_envs=1)[0]
        if isinstance(policy, str):
            found = engine.measured(world, None, params, each, way=policy)
        else:
            found = self._measured([policy], contexts, seeds)
        return {name: found[name][0] for name in (SCORE, *names) if name in found}

    @property
    def how(self) -> Literal["sampled", "mean"]:
        """Actions follow from a policy in all evaluations."""
        if self.algorithm == "DQN":
            return "mean"
        return self.acting or "mean"  # settled when it was made

    # ---- files -------------------------------------------------------------------------------

    def save(self, policy: MLPPolicy, folder: Path) -> bool:
        """Write weights and manifest into the empty `folder`."""
        policy.save(Path(folder))
        return True

    def load(self, folder: Path) -> MLPPolicy:
        """Read what `save` wrote; nothing but numbers is loaded."""
        return MLPPolicy.load(Path(folder))


def _decisions_of(world: Any, params: Any) -> int:
    """Decisions of an episode in one context; of the longest where a world ends when it ends."""
    length = world.decisions(params)
    return int(getattr(length, "decisions", length))


def _each_of(problem: Problem, contexts: Sequence[Context]) -> Any:
    """(T,) `_decisions_of` each context."""
    return np.array([_decisions_of(*problem([one])) for one in contexts])


def _saved(world: Any, state: Path | None) -> Any:
    """The file of a training, where files can hold its simulations."""
    return engine.SavedTraining(state if getattr(world, "storable", True) else None)
