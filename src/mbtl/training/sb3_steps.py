"""Trainings in Stable-Baselines3 that pause and go on, and what evaluations cost in steps.

A training pauses where the library is about to collect the next rollout. What is saved there is all
that decides the future: weights, optimiser, replay, counters, environments in the middle of their
episodes, and the generators of Python, numpy and torch. So an extended training is, bit for bit,
the one of the whole length, with two exceptions:

- Environments that cannot be copied (of MuJoCo, Box2D, SUMO, in processes of their own, teams)
  begin a new episode where a training goes on, seeded by the training's seed and its steps.
- Action noise with a memory (Ornstein-Uhlenbeck) forgets it, since the library resets it.

Where observations are standardised, their statistics move from the first step that goes on, before
any gradient step: so they do at every step of a training of the whole length.

Reading such a file can execute code: only go on with trainings of your own.
"""

from __future__ import annotations

import pickle
import random
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.envs.rollout import Job, play_counted
from mbtl.errors import InvalidInput
from mbtl.files import whole_file
from mbtl.seeds import Purpose, derive_seed, episode_seeds
from mbtl.set_trainer import check_counted, in_steps
from mbtl.trainer import OnProgress, Reached, checked_returns
from mbtl.training.adapted import begin_statistics, model_of
from mbtl.training.isolation import isolated
from mbtl.training.sb3_learning import close, learn, lightened, log_nowhere, run_name
from mbtl.training.watch import EVALUATION_ENVS, Watch, actor_for

if TYPE_CHECKING:
    from mbtl.training.sb3 import SB3Trainer

_SECONDS = 60.0
"""Between two savings of a training that goes on."""


class _Paused(Exception):
    """So many steps are done."""


class SB3Steps:
    """The part of `SB3Trainer` that counts steps (`mbtl.trainer.SteppingTrainer`)."""

    @property
    def whole_steps(self) -> int | None:
        """Environment steps of a whole training; None where episodes are counted."""
        return cast("SB3Trainer", self).timesteps

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
        """Train until `steps` or episodes are done, up to whole rollouts (`SteppingTrainer`).

        The policy has the latest weights, whatever `checkpoint` says: who counts steps evaluates
        policies on the way, and the best of them serves. It may `start` from a model of this
        algorithm.

        Raises:
            InvalidInput: `start` has other weights.
            TrainingFailed: the weights or the actions became NaN.
        """
        trainer = cast("SB3Trainer", self)
        none = None if trainer.episodes is None else 0
        with ExitStack() as stack:
            stack.enter_context(isolated(trainer.threads))
            found = None if saved is None else _thawed(trainer, context, seed, saved, stack)
            model, episodes = found or (None, none)
            if model is None:
                model = trainer._model(trainer._algorithm(), context, seed, stack)
                if start is not None:
                    _begin_with(model, start)
            if trainer.tensorboard is None:
                log_nowhere(model)

            def played() -> int:  # of a team the library counts the steps of every place
                return int(model.num_timesteps) // getattr(model.env, "slots", 1)

            told = on_progress if none is None else in_steps(on_progress, played)
            watch = Watch(model, trainer._length, told, None, episodes, trainer._score)
            if watch.done < steps:
                model.collect_rollouts = _Pausing(model, watch, steps, saved)
                name = run_name(context, seed)
                try:
                    learn(model, trainer.timesteps, watch, name, anew=found is None)
                except _Paused:
                    pass
                finally:
                    del model.collect_rollouts
                if saved is not None:
                    _freeze(model, watch, saved)
            watch.report(watch.done)
            done = watch.done if none is None else played()
            return Reached(lightened(model), done)

    def check_on_set(self) -> None:
        """See `mbtl.set_trainer.SetTrainer`."""
        check_counted(cast("SB3Trainer", self))

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
        """Train one policy on several contexts: every episode is in one drawn from them.

        As `train_steps`; schedules of learning rates and exploration follow the last of the marks.
        """
        self.check_on_set()
        everywhere = replace(self.for_all_contexts(contexts), timesteps=marks[-1])
        return everywhere.train_steps({}, seed, steps, saved=saved, on_progress=on_progress)

    def for_all_contexts(self, contexts: Sequence[Context]) -> SB3Trainer:
        """The same trainer, whose every episode is in a context drawn uniformly from `contexts`.

        Any algorithm trains so unchanged; the context that `train` is given is ignored. One policy
        for all contexts is the baseline of cmdp-spec, 8.3.
        """
        from mbtl.envs.everywhere import Everywhere  # needs Gymnasium

        trainer = cast("SB3Trainer", self)
        return replace(trainer, make_env=Everywhere(trainer.make_env, tuple(contexts)))

    def evaluate_steps(
        self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int] | int
    ) -> tuple[Array, Array]:
        """As `evaluate`, and how many steps each episode had, both (n_targets, eval_episodes)."""
        trainer = cast("SB3Trainer", self)
        each = episode_seeds(seeds, len(contexts), trainer.eval_episodes)
        with isolated(trainer.threads):
            actor = actor_for(policy, sampled=trainer.acting == "sampled")
            most = min(len(contexts), trainer.n_eval_envs or EVALUATION_ENVS)
            open_env, most = trainer.opener(contexts, most)
            pairs = zip(contexts, each, strict=True)
            jobs = [Job(partial(open_env, one), own, trainer._score) for one, own in pairs]
            returns, lasted = play_counted(jobs, actor, max_envs=most)
        returns = [rows[:, 0] for rows in returns]
        shape = (len(jobs), trainer.eval_episodes)
        return checked_returns(np.reshape(returns, shape), len(jobs)), np.reshape(lasted, shape)


class _Pausing:
    """Collects rollouts until so many steps or episodes are done; then the training pauses."""

    def __init__(self, model: Any, watch: Watch, steps: int, saved: Path | None) -> None:
        self._model, self._watch, self._steps, self._saved = model, watch, steps, saved
        self._collect, self._at = model.collect_rollouts, time.monotonic()
        self._planned = model._total_timesteps if watch.episodes else 0  # `learn` plans anew

    def __call__(self, *given: Any, **named: Any) -> Any:
        if self._planned:  # schedules go on as they were
            self._model._total_timesteps, self._planned = self._planned, 0
        if self._watch.done >= self._steps:
            raise _Paused
        if self._saved is not None and time.monotonic() - self._at >= _SECONDS:
            del self._model.collect_rollouts
            _freeze(self._model, self._watch, self._saved)
            self._model.collect_rollouts, self._at = self, time.monotonic()
        return self._collect(*given, **named)


def _freeze(model: Any, watch: Watch, saved: Path) -> None:
    """Write a training that is between two rollouts; it stays as it is."""
    import cloudpickle
    import torch

    envs, normalize, logger = model.env, model._vec_normalize_env, model.__dict__.pop("_logger")
    inner = envs if normalize is None else normalize.venv
    content = {
        "model": model,
        "episodes": watch.episodes,
        "normalize": normalize,
        "returns": None if normalize is None else normalize.returns,
        "envs": inner if _can_be_copied(inner) else None,
        "random": random.getstate(),
        "numpy": np.random.get_state(),  # noqa: NPY002 - the library uses it
        "torch": torch.get_rng_state(),
    }
    model.env = model._vec_normalize_env = None
    try:
        try:
            frozen = cloudpickle.dumps(content)
        except Exception:  # each environment has reasons of its own
            frozen = cloudpickle.dumps({**content, "envs": None})
    finally:
        model.env, model._vec_normalize_env, model._logger = envs, normalize, logger
    with whole_file(saved) as file:
        file.write(frozen)


def _thawed(
    trainer: SB3Trainer, context: Context, seed: int, saved: Path, stack: ExitStack
) -> tuple[Any, int | None] | None:
    """The training in a file, and its episodes; None where there is none."""
    import torch

    try:
        content = pickle.loads(saved.read_bytes())
    except (OSError, EOFError, pickle.UnpicklingError):
        return None
    model, normalize, envs = content["model"], content["normalize"], content["envs"]
    if envs is None:
        envs = trainer._training_envs(context, stack)
        if normalize is not None:
            envs = envs.venv
        envs.seed(derive_seed(seed, Purpose.TRAINING, int(model.num_timesteps)))
        model._last_obs = None  # its episode is lost
    else:
        stack.callback(close, envs)
    if normalize is not None:
        normalize.set_venv(envs)
        if model._last_obs is not None:
            normalize.returns = content["returns"]
        envs = normalize
    model.set_env(envs, force_reset=False)
    random.setstate(content["random"])
    np.random.set_state(content["numpy"])  # noqa: NPY002
    torch.set_rng_state(content["torch"])
    return model, content.get("episodes")


def _can_be_copied(envs: Any) -> bool:
    """Whether a copy is in the middle of the same episodes; Gymnasium's `EzPickle` is not."""
    from gymnasium.utils import EzPickle
    from stable_baselines3.common.vec_env import DummyVecEnv

    if not isinstance(envs, DummyVecEnv):
        return False
    inner = [getattr(env.unwrapped, "current", env).unwrapped for env in envs.envs]
    return not any(isinstance(env, EzPickle) for env in inner)


def _begin_with(model: Any, start: Any) -> None:
    begin_statistics(model, getattr(start, "statistics", {}))
    try:
        model.policy.load_state_dict(model_of(start).policy.state_dict())
    except (AttributeError, RuntimeError) as error:
        raise InvalidInput(
            f"a training begins from a model of its own algorithm and network, got "
            f"{type(start).__name__} ({str(error).splitlines()[0]}); train one with this trainer"
        ) from error
