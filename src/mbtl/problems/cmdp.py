"""A contextual MDP as one record: contexts, a trainer, normalisation, named recipes.

The same record holds our own problems (`mbtl.problems.get_cmdp`) and a user's: built from two
functions (`CMDP.from_functions`), from an environment factory (`CMDP.from_env`), or from any
`Trainer`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

from mbtl.contexts import Context, ContextSpace
from mbtl.errors import ContextMismatch, InvalidInput, check_known
from mbtl.objective import Bounds, Direction, direction_named
from mbtl.plain import short, whole
from mbtl.score import Score
from mbtl.study import Study, create_study
from mbtl.study.problem import Beside, ProblemFacts
from mbtl.trainers.contract import FunctionTrainer, Trainer, recipe_of

DEFAULT_BUDGET = 10
"""Trainings K of a problem that does not say."""

_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")  # an id becomes part of file names


@dataclass(frozen=True)
class Preset:
    """A named recipe: how many policies, trained and evaluated how. None leaves the trainer's own.

    Attributes:
        budget: trainings K, 1..N.
        timesteps: environment steps of one training.
        episodes: of one training, where the trainer counts those.
        eval_episodes: episodes per (source, target).
        algorithm: name of the RL algorithm.
        recipe_name: named hyper-parameters, where the trainer has names for them.
        hyperparameters: its keyword arguments.
        checkpoint: which policy a training returns, the last or the best of its own evaluations.
        checkpoint_every: steps or episodes between those evaluations.
        checkpoint_episodes: episodes of each of them.
        acting: how a policy's actions are chosen in evaluations, "mean" or "sampled".
        reward: what training is rewarded by, where the simulator has names for that.
        actions: what training advises, where the simulator has names for that.
        credit: whose rewards an action of a team is worth in training, "own" or "team".
        clip_actions: learn from actions within their bounds, not from the samples.
        normalize_reward: rewards are brought to one scale in training.
        normalize_observations: learn from standardised observations.
        n_envs: environments stepped together in training.
        description: one line for people.
    """

    budget: int
    timesteps: int | None = None
    episodes: int | None = None
    eval_episodes: int | None = None
    algorithm: str | None = None
    recipe_name: str | None = None
    hyperparameters: Mapping[str, Any] | None = None
    checkpoint: Literal["final", "best"] | None = None
    checkpoint_every: int | None = None
    checkpoint_episodes: int | None = None
    acting: Literal["mean", "sampled"] | None = None
    reward: str | None = None
    actions: str | None = None
    credit: Literal["own", "team"] | None = None
    clip_actions: bool | None = None
    normalize_reward: bool | None = None
    normalize_observations: bool | None = None
    n_envs: int | None = None
    description: str = ""

    def options(self) -> dict[str, Any]:
        """What the recipe asks of the trainer; settings it leaves alone are absent."""
        chosen = {f.name: getattr(self, f.name) for f in fields(self)}
        del chosen["budget"], chosen["description"]
        return {name: value for name, value in chosen.items() if value is not None}


@dataclass(frozen=True)
class Chosen:
    """The recipe of a study.

    Attributes:
        preset: its name.
        trainer: that does it; None: as the preset says.
        trial: which repetition of the same problem.
    """

    preset: str
    trainer: Trainer | None
    trial: int = 0


@dataclass(frozen=True)
class CMDP:
    """A family of tasks that differ by their context, and how policies for it are trained.

    Attributes:
        id: short name, part of file names.
        space: the N contexts, sources and targets alike.
        trainer: trains, evaluates, saves and loads; the default preset's.
        bounds: returns at which performance is 0 and 1 (spec, 2.2); None: from the returns seen. Of
            `Bounds` the direction and the floor count, too.
        direction: whether larger or smaller returns are better; a `Score` to minimise says it, too.
        floor: return below which none is worse in performance; returns themselves are not clipped.
        best_return: the largest return there is (smallest, if minimised); None: not known. A study
            ends where V reaches what it is worth.
        theta: slope of the linear gap, performance per grid step; None: the library's default.
        version: raised when results could change.
        make_env: context -> Gymnasium environment; None for problems given as functions.
        nominal: the context that a user without our help would train on.
        unit: the context at multiplier 1, divisor of the visible multiplier. Not the nominal one.
        horizon: longest episode in environment steps.
        check_steps: environment steps of a rollout of `check_cmdp`; None: its default.
        family: name of the simulator family.
        presets: recipes by name, the first is the default.
        chosen: the recipe that `recipe` chose; None: the first preset.
        score: what an episode is worth, where that is not the sum of its rewards: a key of the
            `info` of its last step, or a `Score`, which has a unit and a direction.
        metrics: what people need to see beside the score: further keys of that `info`, or of what
            `evaluate` returns, and their units.
        baselines: what V is compared with, by name, in the same episodes: a policy, a function of
            an observation that returns an action, or the name of what the environment can do by
            itself ("random_actions", "unguided", or one of its `ways`). The controllers that an
            environment has are always among them.
        settings: switches this problem was made with, e.g. {"visibility": "hidden"}. With `id` and
            `version` they say which problem this is.
        description: one line for people.

    Raises:
        InvalidInput: an id unfit for a file name, bounds or theta not finite, a budget not in 1..N.
        ContextMismatch: `nominal` or `unit` is not a context of these axes.
    """

    id: str
    space: ContextSpace
    trainer: Trainer
    _: KW_ONLY
    bounds: tuple[float, float] | None = None
    direction: Direction = "maximize"
    theta: float | None = None
    version: int = 0
    make_env: Callable[[Context], Any] | None = None
    nominal: Context | None = None
    unit: Context | None = None
    horizon: int | None = None
    check_steps: int | None = None
    family: str = ""
    presets: Mapping[str, Preset] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    description: str = ""
    floor: float | None = None
    best_return: float | None = None
    score: Score | None = None
    metrics: Mapping[str, str] = field(default_factory=dict)
    baselines: Mapping[str, Any] = field(default_factory=dict)
    chosen: Chosen | None = None

    def __post_init__(self) -> None:
        if isinstance(self.bounds, Bounds):
            given = self.bounds
            object.__setattr__(self, "direction", given.direction)
            object.__setattr__(self, "floor", given.floor)
            object.__setattr__(self, "bounds", (given.low, given.high))
        if not (isinstance(self.id, str) and _ID.fullmatch(self.id)):
            raise InvalidInput(
                "the id of a CMDP becomes part of file names: up to 100 letters, digits, '.', '_' "
                f"and '-', a letter or digit first; got {self.id!r}"
            )
        if not isinstance(self.space, ContextSpace):
            raise InvalidInput(
                f"the space of {self.id!r} must be a ContextSpace, got "
                f"{type(self.space).__name__}; build one with ContextSpace.grid"
            )
        object.__setattr__(self, "score", Score.of(self.score))
        if not isinstance(self.metrics, Mapping):
            names = [self.metrics] if isinstance(self.metrics, str) else self.metrics
            object.__setattr__(self, "metrics", dict.fromkeys(names, ""))
        if self.score is not None and self.score.direction == "minimize":
            object.__setattr__(self, "direction", "minimize")
        self._check_values()
        if self.nominal is not None:
            self.space.encode(self.nominal)
        self._check_unit()
        if not self.presets:
            object.__setattr__(self, "presets", _only(min(DEFAULT_BUDGET, self.space.n)))
        for name, preset in self.presets.items():
            if not hasattr(preset.budget, "__index__"):
                raise InvalidInput(
                    "the budget of a problem is its usual number of trainings, got "
                    f"{short(preset.budget)}; a budget of another kind belongs to the study: "
                    "problem.study(budget=mbtl.Steps(...))"
                )
            if not 1 <= preset.budget <= self.space.n:
                raise InvalidInput(
                    f"the budget of a preset is from 1 to the number of contexts ({self.space.n}), "
                    f"got {preset.budget} in {name!r} of {self.id!r}"
                )

    # ---- constructors ------------------------------------------------------------------------

    @classmethod
    def from_functions(
        cls,
        id: str,
        space: ContextSpace,
        *,
        train: Callable[..., Any],
        evaluate: Callable[..., Any],
        save: Callable[[Any, Path], None] | None = None,
        load: Callable[[Path], Any] | None = None,
        score: str | Score | None = None,
        budget: int | None = None,
        **record: Any,
    ) -> CMDP:
        """A problem from two functions; any simulator, any RL library.

        Args:
            id: short name, part of file names.
            space: the contexts.
            train: `train(context, seed)`, or `train(contexts, seed, *, start=None, length=None)`,
                which can do more; see `mbtl.trainers.FunctionTrainer`.
            evaluate: policy, contexts, seeds -> returns, (n_targets,) or (n_targets, n_episodes);
                one seed per context, see `mbtl.trainers.FunctionTrainer`. The same seed should mean
                the same episodes for every policy.
            save: policy, empty folder -> None; with `load` it lets a study keep its policies.
            load: folder -> policy.
            score: where `evaluate` returns a mapping, which of its names counts; the others may be
                `metrics`. None: it returns numbers.
            budget: default number of trainings K; 10, or N if that is smaller.
            **record: further fields of `CMDP`, e.g. `bounds`, `metrics`, `baselines` (each anything
                that `evaluate` takes for a policy).
        """
        counts, record = Score.of(score), cls._checked(record, "from_functions", budget)
        key = None if counts is None else counts.key
        trainer = FunctionTrainer(train, evaluate, save, load, score=key)
        return cls(id, space, trainer, score=counts, **record)

    @classmethod
    def from_env(
        cls,
        id: str,
        space: ContextSpace,
        *,
        make_env: Callable[[Context], Any],
        timesteps: int,
        algorithm: str | type = "PPO",
        hyperparameters: Mapping[str, Any] | None = None,
        eval_episodes: int = 10,
        checkpoint: Literal["final", "best"] = "final",
        show_context: bool = False,
        score: str | Score | None = None,
        normalize_observations: bool = False,
        trainer_options: Mapping[str, Any] | None = None,
        budget: int | None = None,
        **record: Any,
    ) -> CMDP:
        """A problem from a Gymnasium environment factory and a Stable-Baselines3 algorithm.

        Args:
            id: short name, part of file names.
            space: the contexts.
            make_env: context -> `gymnasium.Env`, a new one at each call. Episodes must end.
            timesteps: environment steps of one training.
            algorithm: a name in stable-baselines3 or sb3-contrib, or an algorithm class.
            hyperparameters: keyword arguments of the algorithm.
            eval_episodes: episodes per (source, target).
            checkpoint: return the last policy of a training, or the best of its own evaluations.
            show_context: end each observation with the context (`mbtl.problems.shown.ShowContext`).
            score: what an episode is worth: a key of the `info` of its last step, or a `Score`;
                None: the sum of its rewards.
            normalize_observations: learn from standardised observations; their statistics are kept
                with the policy.
            trainer_options: further options of `mbtl.trainers.SB3Trainer`.
            budget: default number of trainings K; 10, or N if that is smaller.
            **record: further fields of `CMDP`, e.g. `bounds`, `metrics`, `baselines`, `presets`.
        """
        from mbtl.trainers import SB3Trainer

        record = cls._checked(record, "from_env", budget)
        if show_context:
            from mbtl.problems.shown import Showing

            make_env = Showing(make_env, space)
            record["settings"] = {**record.get("settings", {}), "visibility": "cube"}

        known = {one.name for one in fields(SB3Trainer)}
        for name in trainer_options or {}:
            check_known("option of SB3Trainer", name, known)
        trainer = SB3Trainer(
            make_env,
            timesteps=timesteps,
            algorithm=algorithm,
            hyperparameters=hyperparameters or {},
            eval_episodes=eval_episodes,
            checkpoint=checkpoint,
            score=score,
            normalize_observations=normalize_observations,
            **(trainer_options or {}),
        )
        return cls(id, space, trainer, make_env=make_env, score=Score.of(score), **record)

    # ---- reading -----------------------------------------------------------------------------

    @property
    def normalisation(self) -> Bounds | None:
        """`bounds` with direction and floor; None when they come from the returns seen."""
        return None if self.bounds is None else Bounds(*self.bounds, self.direction, self.floor)

    @property
    def default_preset(self) -> str:
        """Name of the recipe that is used when none is named."""
        return next(iter(self.presets))

    def preset(self, name: str | None = None) -> Preset:
        """A recipe by name; the default one for None.

        Raises:
            UnknownName: this problem has no such recipe.
        """
        name = self.default_preset if name is None else name
        check_known(f"preset of {self.id!r}", name, self.presets)
        return self.presets[name]

    def trainer_for(self, preset: str | None = None, **overrides: Any) -> Trainer:
        """The trainer with a recipe's options, then `overrides` on top.

        Another `algorithm` drops the recipe's hyperparameters, which belong to the old one; given
        `hyperparameters` are otherwise added to the recipe's.

        Args:
            preset: name of the recipe; None: the default one.
            **overrides: options of the trainer, e.g. `timesteps=20_000`.

        Raises:
            UnknownName: no such recipe, or the trainer has no such option.
            InvalidInput: the trainer takes no options at all.
        """
        options = self.preset(preset).options()
        if "algorithm" in options:  # a recipe that names its algorithm is complete
            options.setdefault("hyperparameters", {})
            for name in ("reward", "actions"):
                if hasattr(self.trainer, name):
                    options.setdefault(name, None)
        algorithm = options.get("algorithm", getattr(self.trainer, "algorithm", None))
        if overrides.get("algorithm", algorithm) != algorithm:
            options["hyperparameters"] = {}
        if "hyperparameters" in overrides:
            own = getattr(self.trainer, "hyperparameters", {})
            inherited = options.get("hyperparameters", own)
            overrides["hyperparameters"] = {**inherited, **overrides["hyperparameters"]}
        options |= overrides
        return self._with_options(options) if options else self.trainer

    def facts(self, preset: str | None = None, trainer: Trainer | None = None) -> ProblemFacts:
        """What a study takes from this problem.

        Args:
            preset: name of the recipe; None: the default one.
            trainer: where it differs from the recipe, e.g. `trainer_for(preset, timesteps=100)`.
        """
        chosen = self.chosen or Chosen(self.default_preset, None)
        if preset is None:
            preset, trainer = chosen.preset, chosen.trainer if trainer is None else trainer
        trainer = self.trainer_for(preset) if trainer is None else trainer
        settings = {
            "preset": preset,
            "version": self.version,
            "switches": dict(self.settings),
            "recipe": recipe_of(trainer),
            "policy_format": trainer.policy_format,
        }
        if self.score is not None:
            settings["score"] = {"name": self.score.key, "unit": self.score.unit}
        return ProblemFacts(
            self.space,
            self.preset(preset).budget,
            self.normalisation,
            self.direction,
            self.theta,
            self.best_return,
            self.id,
            settings,
            trainer,
            self.horizon,
            chosen.trial,
            Beside(self.metrics, self.baselines),
        )

    def recipe(
        self,
        preset: str | None = None,
        *,
        trainer: Trainer | None = None,
        trial: int = 0,
        **overrides: Any,
    ) -> CMDP:
        """The same, trained by another recipe: what a study of it then goes by.

        Args:
            preset: name of the recipe; None: the default one.
            trainer: in place of the recipe's.
            trial: repetition; another trial has other training seeds.
            **overrides: options of the trainer, e.g. `timesteps=20_000` (`trainer_for`).

        Raises:
            UnknownName: no such recipe, or the trainer has no such option.
            InvalidInput: a trainer and options, or a trial that is no whole number >= 0.
        """
        if trainer is not None and overrides:
            raise InvalidInput(
                f"a recipe takes a trainer or options of one, got both, {sorted(overrides)}; set "
                "them on that trainer"
            )
        if whole("trial", trial) < 0:
            raise InvalidInput(f"a trial is a whole number >= 0, got {trial}")
        name = self.default_preset if preset is None else preset
        made = self.trainer_for(name, **overrides) if trainer is None else trainer
        return replace(self, chosen=Chosen(name, made, trial))

    def study(self, **settings: Any) -> Study:
        """Start a study of this problem; `study.run()` then trains with its recipe.

        Args:
            **settings: further arguments of `mbtl.create_study`, e.g. `storage`, `seed`, `budget`.

        Raises:
            StudyError: as of `mbtl.create_study`, for a study that exists.
        """
        return create_study(self, **settings)

    def every(self, step: int) -> CMDP:
        """The same on a coarser grid: each `step`-th value per axis (`ContextSpace.every`)."""
        space = self.space.every(step)
        presets = {
            name: replace(preset, budget=min(preset.budget, space.n))
            for name, preset in self.presets.items()
        }
        theta = None if self.theta is None else self.theta * step
        settings = {**self.settings, "every": step}
        return replace(self, space=space, theta=theta, presets=presets, settings=settings)

    # ---- inside ------------------------------------------------------------------------------

    @classmethod
    def _checked(cls, record: dict[str, Any], maker: str, budget: int | None) -> dict[str, Any]:
        """Fields beyond id, space and trainer, with the recipe of a budget where one is given."""
        known = {*getattr(cls, maker).__kwdefaults__, *(one.name for one in fields(cls)[3:])}
        for name in record:
            check_known(f"argument of CMDP.{maker}", name, known)
        if budget is None or record.get("presets"):
            return record
        return {**record, "presets": _only(budget)}

    def _with_options(self, options: Mapping[str, Any]) -> Trainer:
        trainer: Any = self.trainer
        if isinstance(trainer, FunctionTrainer) or not is_dataclass(trainer):
            raise InvalidInput(
                f"{self.id!r} is trained by its own code, which takes no options, got "
                f"{', '.join(sorted(options))}; set them there"
            )
        known = [f.name for f in fields(trainer) if f.init]
        for name in options:
            check_known(f"training option of {self.id!r}", name, known)
        changed: Any = replace(trainer, **options)  # type: ignore[type-var]
        return cast(Trainer, changed)

    def _check_values(self) -> None:
        for name in ("baselines", "presets", "settings"):
            if not isinstance(given := getattr(self, name), Mapping):
                raise InvalidInput(f"{name} are a mapping by name, got {short(given)}; name each")
        object.__setattr__(self, "direction", direction_named(self.direction))
        if self.bounds is not None:
            if not hasattr(self.bounds, "__len__") or len(self.bounds) != 2:
                raise InvalidInput(f"bounds are two returns (low, high), got {short(self.bounds)}")
            Bounds(*self.bounds, self.direction, self.floor)
        if self.theta is not None and not (math.isfinite(self.theta) and self.theta >= 0):
            raise InvalidInput(f"theta must be finite and >= 0, got {self.theta!r}")
        for name, least in (("version", 0), ("horizon", 1), ("check_steps", 1)):
            number = getattr(self, name)
            if number is not None and not (isinstance(number, int) and number >= least):
                raise InvalidInput(f"{name} must be a whole number >= {least}, got {number!r}")

    def _check_unit(self) -> None:
        names = [axis.name for axis in self.space.axes]
        for name, value in (self.unit or {}).items():
            check_known("axis", name, names)
            if not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0):
                raise ContextMismatch(
                    f"unit is the context at multiplier 1, so its values are > 0, got {value!r} "
                    f"for {name!r}"
                )


def _only(budget: int) -> dict[str, Preset]:
    """The recipe of a problem that names none: the trainer's own, so many trainings."""
    return {"default": Preset(budget)}
