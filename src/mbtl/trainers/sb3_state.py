"""Trainings in Stable-Baselines3 that pause and go on, and those that begin with a policy.

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
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.errors import InvalidInput
from mbtl.files import whole_file
from mbtl.seeds import Purpose, derive_seed
from mbtl.trainers.adapted import begin_statistics, model_of
from mbtl.trainers.contract import OnProgress, Progress
from mbtl.trainers.sb3_learning import Watch, close, log_nowhere

_SECONDS = 60.0
"""Between two savings of a training that goes on."""


class _Paused(Exception):
    """So much is done."""


@contextmanager
def pausing(model: Any, watch: Watch, until: int, state: Path | None) -> Iterator[None]:
    """What learns inside ends when so many steps or episodes are done, and is saved on the way."""
    model.collect_rollouts = _Pausing(model, watch, until, state)
    with suppress(_Paused):
        try:
            yield
        finally:
            del model.collect_rollouts


def in_steps(on_progress: OnProgress | None, played: Callable[[], int]) -> OnProgress | None:
    """Reports of a training that counts episodes, in the environment steps `played` so far."""
    if on_progress is None:
        return None

    def told(progress: Progress) -> None:
        steps = played()
        total = round(steps * progress.total / max(progress.step, 1))
        on_progress(replace(progress, step=steps, total=total, unit="steps"))

    return told


class _Pausing:
    """Collects rollouts until so many steps or episodes are done; then the training pauses."""

    def __init__(self, model: Any, watch: Watch, until: int, state: Path | None) -> None:
        self._model, self._watch, self._until, self._state = model, watch, until, state
        self._collect, self._at = model.collect_rollouts, time.monotonic()
        self._planned = model._total_timesteps if watch.episodes else 0  # `learn` plans anew

    def __call__(self, *given: Any, **named: Any) -> Any:
        if self._planned:  # schedules go on as they were
            self._model._total_timesteps, self._planned = self._planned, 0
        if self._watch.done >= self._until:
            raise _Paused
        if self._state is not None and time.monotonic() - self._at >= _SECONDS:
            del self._model.collect_rollouts
            freeze(self._model, self._watch, self._state)
            self._model.collect_rollouts, self._at = self, time.monotonic()
        return self._collect(*given, **named)


def freeze(model: Any, watch: Watch, state: Path) -> None:
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
    with whole_file(state) as file:
        file.write(frozen)


def thawed(
    state: Path, seed: int, make_envs: Callable[[], Any], stack: ExitStack
) -> tuple[Any, int | None] | None:
    """The training in a file, and its episodes; None where there is none."""
    import torch

    try:
        content = pickle.loads(state.read_bytes())
    except (OSError, EOFError, pickle.UnpicklingError):
        return None
    model, normalize, envs = content["model"], content["normalize"], content["envs"]
    log_nowhere(model)
    if envs is None:
        envs = make_envs()
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
    return not any(isinstance(env.unwrapped, EzPickle) for env in envs.envs)


def begin_with(model: Any, start: Any) -> None:
    """Give it the weights and statistics of another model.

    Raises:
        InvalidInput: that has other weights.
    """
    begin_statistics(model, getattr(start, "statistics", {}))
    try:
        model.policy.load_state_dict(model_of(start).policy.state_dict())
    except (AttributeError, RuntimeError) as error:
        raise InvalidInput(
            f"a training begins from a model of its own algorithm and network, got "
            f"{type(start).__name__} ({str(error).splitlines()[0]}); train one with this trainer"
        ) from error
