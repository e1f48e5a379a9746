"""One training in Stable-Baselines3: reports, the best checkpoint, what goes wrong, what is kept.

The library seeds and uses global generators, which nobody else should notice (`isolated`).

A training pauses where the library is about to collect the next rollout. What is saved there is all
that decides the future: weights, optimiser, replay, counters, environments in the middle of their
episodes, and the generators of Python, numpy and torch. So an extended training is, bit for bit,
the one of the whole length, with two exceptions:

- Environments that cannot be copied (of MuJoCo, Box2D, SUMO, in processes of their own, teams), or
  whose copies cannot be stepped (`_goes_on`), begin a new episode where a training goes on, seeded
  by the training's seed and its steps.
- Action noise with a memory (Ornstein-Uhlenbeck) forgets it, since the library resets it.

Where observations are standardised, their statistics move from the first step that goes on, before
any gradient step: so they do at every step of a training of the whole length.

Reading such a file can execute code: only go on with trainings of your own.
"""

from __future__ import annotations

import pickle
import random
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.envs.references import Controller
from mbtl.envs.rollout import ENDED, Actor, Job, end, play
from mbtl.errors import InvalidInput, SimulationFailed, TrainingFailed
from mbtl.files import whole_file
from mbtl.score import Score
from mbtl.seeds import Purpose, derive_seed
from mbtl.trainers.adapted import Statistics, adapted, begin_statistics, model_of
from mbtl.trainers.contract import OnProgress, Progress
from mbtl.trainers.export import export_mlp

REPORTS = 100
"""Progress reports per training."""

EVALUATION_ENVS = 128
"""Environments alive at once in an evaluation, when `n_eval_envs` does not say otherwise."""

_RECENT = 100
"""Episodes whose mean is reported, as in Stable-Baselines3."""

_GONE = (EOFError, BrokenPipeError, ConnectionResetError)
"""What the end of another process looks like from here."""

_FOREVER = 1 << 62
"""Steps of a training that counts its episodes."""


def log_nowhere(model: Any) -> None:
    """Keep the library from making an empty temporary folder for each training."""
    from stable_baselines3.common.logger import Logger

    model.set_logger(Logger(folder=None, output_formats=[]))


def learn(model: Any, total: int | None, watch: Watch, *, anew: bool = True) -> None:
    """Learn, and turn a divergence into an error that names it; not `anew`: go on to the total."""
    left = (_FOREVER if total is None else total) - (0 if anew else int(model.num_timesteps))
    try:
        model.learn(left, callback=watch, reset_num_timesteps=anew)
    except _GONE as error:
        raise SimulationFailed(
            f"a training needs its simulators, got the end of a process ({type(error).__name__}) "
            "that has written its own reason; mend that, or train with processes=False to see it "
            "here"
        ) from error
    except ValueError as error:
        # torch's distributions refuse NaN parameters with a ValueError; any other passes
        if "invalid values" not in str(error) and _finite(model):
            raise
        raise _diverged(model) from error
    if not _finite(model):
        raise _diverged(model)


def close(envs: Any) -> None:
    """Close them; a process that is gone cannot answer, and what ended it is told elsewhere."""
    with suppress(*_GONE):
        end(envs)


def _finite(model: Any) -> bool:
    return all(bool(parameter.isfinite().all()) for parameter in model.policy.parameters())


def _diverged(model: Any) -> TrainingFailed:
    return TrainingFailed(
        f"training must keep finite weights and actions, got NaN by step {model.num_timesteps}; "
        "lower the learning rate, or check that observations and rewards are finite"
    )


def lightened(model: Any) -> Any:
    """The policy: of the model, what only training needs is dropped.

    Those are environments (soon to be closed), buffers and open log files.
    """
    policy = adapted(model)
    model.logger.close()
    model.env = model._vec_normalize_env = None
    for name in ("_logger", "_last_obs", "_last_original_obs", "_last_episode_starts"):
        model.__dict__.pop(name, None)
    for name in ("replay_buffer", "rollout_buffer"):
        if hasattr(model, name):
            setattr(model, name, None)
    for module in (model.policy, getattr(model.policy, "actor", None)):
        _forget_last_actions(getattr(module, "action_dist", None))
    return policy


def _forget_last_actions(distribution: Any) -> None:
    """Drop the graph of the last forward pass: torch sends no such tensors to another process."""
    import torch

    for name, part in vars(distribution).items() if distribution is not None else ():
        if isinstance(part, torch.Tensor):
            setattr(distribution, name, part.detach())
        elif isinstance(part, torch.distributions.Distribution) or name == "distribution":
            setattr(distribution, name, None)  # made anew by every forward pass


# ---- what happens while a model learns ----------------------------------------------------------


def actor_for(policy: Any, *, sampled: bool = False) -> Actor:
    """Actor of a policy, on its numpy copy when there is one (about ten times as fast as torch).

    A function without `predict` is a controller: it returns the action of one observation.
    """
    if callable(policy) and not hasattr(policy, "predict"):
        return Actor(Controller(policy))
    exported = export_mlp(policy) if hasattr(model_of(policy), "policy") else None
    return Actor(policy if exported is None else exported, sampled)


class BestCheckpoint:
    """Keeps the weights with the best mean return over fixed episodes on the model's own context.

    The episodes have their own environments and the same seeds at every checkpoint, so that weights
    are compared, not luck. Of equal checkpoints the earliest is kept, as in the reference protocol
    (cmdp-spec, section 3). Unchanged weights are not evaluated again.
    """

    def __init__(
        self,
        envs: Sequence[Any],
        seeds: Sequence[int],
        every: int,
        *,
        sampled: bool = False,
        score: Score | None = None,
    ) -> None:
        """`seeds`, one per episode, are dealt out over `envs`; `every` is in units of training."""
        self._sampled = sampled
        self._jobs = [
            Job(partial(_same, e), seeds[i :: len(envs)], score) for i, e in enumerate(envs)
        ]
        self._every, self._due = every, every
        self._updates: int | None = None
        self._weights: dict[str, Any] = {}
        self._statistics: Statistics | None = None
        self.latest: float | None = None
        self.best: float | None = None

    def visit(self, model: Any, done: int, *, last: bool = False) -> None:
        """Evaluate if a checkpoint is due (or this is the last) and the weights have changed."""
        if not last and done < self._due:
            return
        self._due = done + self._every
        if model._n_updates == self._updates:
            return
        self._updates = model._n_updates
        policy = adapted(model)
        actor = actor_for(policy, sampled=self._sampled)
        returns = play(self._jobs, actor, max_envs=len(self._jobs), keep_open=True)
        self.latest = float(np.concatenate(returns).mean())
        if self.best is None or self.latest > self.best:
            self.best = self.latest
            state = model.policy.state_dict()
            self._weights = {name: tensor.detach().clone() for name, tensor in state.items()}
            self._statistics = getattr(policy, "statistics", None)

    def restore(self, model: Any) -> None:
        """Put the best weights back."""
        if self._weights:
            model.policy.load_state_dict(self._weights)
            begin_statistics(model, self._statistics)


class Watch:
    """Callback of one training, called after every environment step.

    The unit of training is the environment step; or the episode, where the `episodes` so far are
    given: a key of an info comes once with each.
    """

    def __init__(
        self,
        model: Any,
        total: int,
        on_progress: OnProgress | None,
        best: BestCheckpoint | None,
        episodes: int | None = None,
        score: Score | None = None,
    ) -> None:
        self._score = score
        self._model, self._total, self._on_progress, self._best = model, total, on_progress, best
        ends = ENDED if hasattr(model.env, "slots") else "episode"  # of a team
        self._ends = None if episodes is None else ends
        self._interval = max(1, total // REPORTS)
        self._due, self.episodes = self._interval, episodes
        self._scores: deque[float] = deque(maxlen=_RECENT)

    @property
    def done(self) -> int:
        """Units so far."""
        return int(self._model.num_timesteps) if self.episodes is None else self.episodes

    def __call__(self, given: dict[str, Any], _globals: dict[str, Any]) -> bool:
        """Form of a Stable-Baselines3 function callback; False: enough."""
        # one step into the next episode: what ends on the last step has been learnt from by then
        enough = self.episodes is not None and self.episodes >= self._total
        infos = given.get("infos", ())
        if self._score is not None:
            key = self._score.key
            ends = [info for info in infos if "episode" in info or ENDED in info]
            self._scores.extend(float(info[key]) for info in ends if key in info)
        if self.episodes is not None:
            ended = sum(self._ends in info for info in infos)
            if ended:
                self.episodes += ended
                # schedules of the library run over steps: as many as the episodes make likely
                steps = int(self._model.num_timesteps * self._total / self.episodes)
                self._model._total_timesteps = max(steps, self._model.num_timesteps)
        if self._best is not None:
            self._best.visit(self._model, self.done)
        if self.done >= self._due:
            self._due = self.done + self._interval
            self.report(min(self.done, self._total))
        return not enough

    def report(self, step: int) -> None:
        """Tell the caller where the training stands."""
        if self._on_progress is None:
            return
        metrics: dict[str, float] = {}
        episodes = self._model.ep_info_buffer
        if self._scores:  # what policies are judged by, where that is not the return
            metrics["score"] = float(np.mean(self._scores))
        elif episodes:
            metrics["episode_return"] = float(np.mean([episode["r"] for episode in episodes]))
        if self._best is not None and self._best.best is not None:
            metrics["checkpoint_return"] = float(self._best.latest or 0.0)
            metrics["best_return"] = self._best.best
        unit = "episodes" if self._ends else "steps"
        self._on_progress(Progress(step, self._total, metrics, unit))


def _same(env: Any) -> Any:
    return env


@contextmanager
def isolated(threads: int = 1) -> Iterator[None]:
    """Run a block, then put back the global generators (random, numpy, torch) and torch's threads.

    Args:
        threads: torch threads inside the block; small networks are fastest, and reproducible across
            machines of different size, with one.
    """
    import torch

    python_state, torch_state = random.getstate(), torch.get_rng_state()
    numpy_state = np.random.get_state()  # noqa: NPY002 - the library seeds it
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        torch.set_rng_state(torch_state)
        np.random.set_state(numpy_state)  # noqa: NPY002
        random.setstate(python_state)


# ---- trainings that pause, and that begin with a policy ------------------------------------------


_SECONDS = 60.0
"""Between two savings of a training that goes on."""


class _Paused(Exception):
    """So much is done."""


@contextmanager
def pausing(model: Any, watch: Watch, until: int, state: Path | None) -> Iterator[None]:
    """What learns inside ends when so many steps or episodes are done, and is saved on the way."""
    collect, saved = model.collect_rollouts, time.monotonic()
    planned = model._total_timesteps if watch.episodes else 0  # `learn` plans anew

    def collected(*given: Any, **named: Any) -> Any:
        """Rollouts until so many steps or episodes are done; then the training pauses."""
        nonlocal saved, planned
        if planned:  # schedules go on as they were
            model._total_timesteps, planned = planned, 0
        if watch.done >= until:
            raise _Paused
        if state is not None and time.monotonic() - saved >= _SECONDS:
            del model.collect_rollouts
            freeze(model, watch, state)
            model.collect_rollouts, saved = collected, time.monotonic()
        return collect(*given, **named)

    model.collect_rollouts = collected
    with suppress(_Paused):
        try:
            yield
        finally:
            del model.collect_rollouts


def in_steps(on_progress: OnProgress, played: Callable[[], int]) -> OnProgress:
    """Reports of a training that counts episodes, in the environment steps `played` so far."""

    def told(progress: Progress) -> None:
        steps = played()
        total = round(steps * progress.total / max(progress.step, 1))
        on_progress(replace(progress, step=steps, total=total, unit="steps"))

    return told


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
    if envs is None or not _goes_on(envs):
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


def _goes_on(envs: Any) -> bool:
    """Whether environments from a file can be stepped, tried with copies of them.

    Of a simulation that lives elsewhere (a module, as that of SUMO) the file has none, though all
    that Python knew of it. What cannot be stepped is left as it is: nothing of it is open.
    """
    import cloudpickle

    try:
        tried = pickle.loads(cloudpickle.dumps(envs))
        tried.step(np.array([tried.action_space.sample() for _ in range(tried.num_envs)]))
    except Exception:  # each environment has reasons of its own
        return False
    return True


def begin_with(model: Any, start: Any) -> None:
    """Give it the weights and statistics of another model.

    Raises:
        InvalidInput: that has other weights.
    """
    begin_statistics(model, getattr(start, "statistics", None))
    try:
        model.policy.load_state_dict(model_of(start).policy.state_dict())
    except (AttributeError, RuntimeError) as error:
        raise InvalidInput(
            f"a training begins from a model of its own algorithm and network, got "
            f"{type(start).__name__} ({str(error).splitlines()[0]}); train one with this trainer"
        ) from error
