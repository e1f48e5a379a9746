"""Stable-Baselines3: a trainer from environments and an algorithm, imported when it is needed."""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Context
from mbtl.envs.references import played, ways_in
from mbtl.envs.rollout import end, one_instance
from mbtl.errors import InvalidInput, Notice, check_known
from mbtl.processes import usable_cores
from mbtl.score import SCORE, Score
from mbtl.seeds import action_seed, checkpoint_seeds, episode_seeds
from mbtl.settings import described
from mbtl.trainers.algorithms import algorithm_class, check_name, checked_hyperparameters
from mbtl.trainers.contract import (
    Ability,
    OnProgress,
    Trained,
    check_asked,
    check_settings,
    checked_returns,
)
from mbtl.trainers.sb3_files import load_sb3, save_sb3
from mbtl.trainers.sb3_learning import (
    EVALUATION_ENVS,
    BestCheckpoint,
    Watch,
    actor_for,
    begin_with,
    close,
    freeze,
    in_steps,
    isolated,
    learn,
    lightened,
    log_nowhere,
    pausing,
    thawed,
)

_COUNTS = ("eval_episodes", "checkpoint_episodes", "n_envs", "threads")
_OPTIONAL_COUNTS = ("timesteps", "episodes", "checkpoint_every", "n_eval_envs")

EPISODE = "episode"
"""Value of a hyperparameter: the steps of one episode, which the environment must tell."""


@dataclass(frozen=True)
class SB3Trainer:
    """Trains policies with Stable-Baselines3 or sb3-contrib (`mbtl.trainers.Trainer`).

        trainer = SB3Trainer(make_env, algorithm="PPO", timesteps=100_000)
        policy = trainer.train([{"length": 0.5}], seed=0).policy
        returns = trainer.evaluate(policy, space.contexts, range(space.n))  # (n_targets, 10)

    It can be pickled when `make_env` can (a function of a module), so trainings can run in other
    processes; the same seed gives the same weights there.

    Attributes:
        make_env: context -> `gymnasium.Env`, new on every call, with a time limit; or a PettingZoo
            parallel environment, whose agents then share the policy (`mbtl.trainers.shared`).
        timesteps: environment steps of one training; or else
        episodes: its episodes.
        algorithm: name (PPO, DQN, SAC, ..., TRPO, RecurrentPPO, ...) or class.
        policy: the library's policy name ("MlpPolicy", "CnnPolicy", "MultiInputPolicy") or class.
        hyperparameters: keyword arguments of the algorithm. The value "episode" stands for the
            steps of one episode in the context, the environment's attribute `episode_steps`.
        credit: whose rewards an action of a team is worth: the agent's "own" until it leaves, or
            those of the "team" until the episode ends; see `mbtl.trainers.shared`.
        clip_actions: on-policy algorithms learn from actions within their bounds, not from the
            samples beyond; see `mbtl.trainers.applied`.
        normalize_reward: divide rewards by the deviation of discounted returns (`VecNormalize`).
        normalize_observations: learn from standardised observations (`VecNormalize`). Mean and
            deviation are learnt in training, and kept, frozen, with the policy.
        score: what an episode is worth: a key of the `info` of its last step, or a
            `mbtl.score.Score`; None: the sum of its rewards.
        eval_episodes: episodes per target in `evaluate`.
        acting: "mean": deterministic actions. "sampled": as in training, drawn from the seed of the
            episode; for dense policies.
        checkpoint: "final" weights, or the "best" of periodic evaluations on the own context
            (`checkpoint_episodes` episodes, always the same, on their own environments). The best
            of noisy means is an optimistic choice; `evaluate` uses other episodes.
        checkpoint_every: steps (or episodes, where those are counted) between those evaluations;
            default 2 % of the training.
        checkpoint_episodes: episodes per checkpoint.
        n_eval_envs: environments alive at once while evaluating; fewer for heavy simulators. The
            returns do not depend on it.
        n_envs: training environments; for teams, simulations.
        processes: one process for each of them, instead of stepping them in turn in this one.
        apart: every environment has a process of its own, as simulators need of which there can be
            one in a process. None: found out before two are open at once.
        device: torch device.
        threads: torch threads while training and evaluating.

    Raises:
        InvalidInput: a number is not positive, `checkpoint` is neither "final" nor "best", or not
            exactly one of `timesteps` and `episodes` is given.
        UnknownName: no such algorithm, or way to act.
    """

    make_env: Callable[[Context], Any]
    _: KW_ONLY
    timesteps: int | None = None
    episodes: int | None = None
    algorithm: str | type = "PPO"
    policy: str | type = "MlpPolicy"
    hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    credit: Literal["own", "team"] = "own"
    clip_actions: bool = False
    normalize_reward: bool = False
    normalize_observations: bool = False
    score: str | Score | None = None
    eval_episodes: int = 10
    acting: Literal["mean", "sampled"] = "mean"
    checkpoint: Literal["final", "best"] = "final"
    checkpoint_every: int | None = None
    checkpoint_episodes: int = 5
    n_eval_envs: int | None = None
    n_envs: int = 1
    processes: bool = False
    apart: bool | None = None
    device: str = "cpu"
    threads: int = 1

    policy_format = "sb3"
    on_sets: ClassVar[Mapping[str, str]] = {"contexts": "uniform, one per episode"}
    """How the recipe of one policy for several contexts differs."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "hyperparameters", dict(self.hyperparameters or {}))
        object.__setattr__(self, "score", Score.of(self.score))
        if not callable(self.make_env):
            raise InvalidInput(f"make_env must be a function of a context, got {self.make_env!r}")
        check_settings(self, _COUNTS, _OPTIONAL_COUNTS)
        check_known("credit", self.credit, ("own", "team"))
        check_name(self.algorithm)

    @property
    def takes(self) -> frozenset[Ability]:
        """All but "resume": a whole training is not saved on the way."""
        return frozenset({"sets", "start", "length", "state"})

    @property
    def whole(self) -> int:
        """Of a training, in steps or episodes."""
        length = self.timesteps if self.episodes is None else self.episodes
        assert length is not None
        return length

    @property
    def counts(self) -> Literal["steps", "episodes"]:
        """What `whole` counts."""
        return "steps" if self.episodes is None else "episodes"

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
        """Train one policy (`mbtl.trainers.Trainer`); the same seed gives the same weights.

        On several contexts one is drawn uniformly for every episode, which any algorithm learns
        from unchanged. A training of a given `length` goes up to whole rollouts, and its policy has
        the latest weights, whatever `checkpoint` says: who chooses lengths evaluates policies on
        the way, and the best of them serves. Its schedules follow one unit, or the length where
        that is more; the library's own rates are constant. A `start` is a model of this algorithm.

        Returns:
            The policy is the library's model, without its environments and buffers; in an
            `mbtl.trainers.adapted.AdaptedPolicy` where it counts choices from elsewhere than 0, or
            standardises observations.

        Raises:
            TrainingFailed: the weights or the actions became NaN.
            InvalidInput: there are no contexts, a hyperparameter that the algorithm does not have,
                or `start` has other weights.
        """
        check_asked(self, contexts, start, length)
        if len(contexts) > 1:
            from mbtl.envs.everywhere import Everywhere  # needs Gymnasium

            asked: dict[str, Any] = {"start": start, "state": state, "on_progress": on_progress}
            # the same in all contexts; what context it is given does not matter
            everywhere = replace(self, make_env=Everywhere(self.make_env, tuple(contexts)))
            return everywhere.train([{}], seed, length=length, done=done, **asked)
        context, by_episodes = contexts[0], self.episodes is not None
        until = None if length is None else round(length * self.whole)
        begun = round(done * self.whole)
        planned = max(self.whole, until or 0)
        algorithm = self._algorithm()  # before torch is needed
        with ExitStack() as stack:
            stack.enter_context(isolated(self.threads))
            best = self._best_checkpoint(context, seed, stack) if until is None else None
            found = None
            if until is not None and state is not None:
                make_envs = partial(self._training_envs, context, stack)
                found = thawed(state, seed, make_envs, stack)
            model, episodes = found or self._begun(algorithm, context, seed, start, begun, stack)

            def played() -> int:  # of a team the library counts the steps of every place
                return int(model.num_timesteps) // getattr(model.env, "slots", 1)

            told = on_progress
            if by_episodes and until is not None and on_progress is not None:
                told = in_steps(on_progress, played)
            watch = Watch(model, planned, told, best, episodes, self._score)
            anew = found is None and begun == 0
            if until is None:
                learn(model, self.timesteps, watch, anew=anew)
                if best is not None:
                    best.visit(model, watch.done, last=True)
                    best.restore(model)
                watch.report(self.whole)
            else:
                if watch.done < until:
                    with pausing(model, watch, until, state):
                        learn(model, None if by_episodes else planned, watch, anew=anew)
                    if state is not None:
                        freeze(model, watch, state)
                watch.report(watch.done)
            steps = played() if by_episodes else watch.done
            unknown = by_episodes and begun > 0 and found is None  # how long those before lasted
            return Trained(lightened(model), None if unknown else steps)

    def _begun(
        self, algorithm: Any, context: Context, seed: int, start: Any, done: int, stack: ExitStack
    ) -> tuple[Any, int | None]:
        """The library's model before it learns, and episodes so far where those are counted."""
        model = self._model(algorithm, context, seed, stack)
        if start is not None:
            begin_with(model, start)
        if self.episodes is not None:
            return model, done
        model.num_timesteps = done
        return model, None

    def untrained(self, context: Context) -> Any:
        """A policy as a training begins with it (`mbtl.trainers.RehearsingTrainer`).

        Before, an episode of random actions is looked at: `mbtl.envs.opening`.

        Raises:
            InvalidInput: the environments are not new, keep running statistics, have spaces that no
                algorithm takes, or show what is far outside of them.
            TrainingFailed: an episode does not end.
        """
        self._look_at(context)
        one = replace(self, n_envs=1, processes=False)
        algorithm = self._algorithm()  # before torch is needed
        with ExitStack() as stack, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what the library says of fewer environments
            stack.enter_context(isolated(self.threads))
            return lightened(one._model(algorithm, context, 0, stack))

    def evaluate(
        self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int] | int
    ) -> Array:
        """What episodes are worth (see `mbtl.envs.rollout`), (n_targets, eval_episodes).

        The seeds of a context's episodes follow from the one given for it, so they are the same for
        every policy, and a return does not depend on the other targets of the call. The policy may
        be an `MLPPolicy`, too.

        Raises:
            InvalidInput: there is another number of seeds than of contexts.
            TrainingFailed: a return is NaN or infinite, or an episode does not end.
        """
        return self.evaluate_steps(policy, contexts, seeds)[0]

    def evaluate_steps(
        self, policy: Any, contexts: Sequence[Context], seeds: Sequence[int] | int
    ) -> tuple[Array, Array]:
        """As `evaluate`, and how many steps each episode had, both (n_targets, eval_episodes)."""
        told, lasted = self._play(policy, contexts, seeds)
        shape = (len(contexts), self.eval_episodes)
        returns = np.reshape(told[SCORE], shape)
        return checked_returns(returns, len(contexts), contexts), np.reshape(lasted, shape)

    def ways(self, contexts: Sequence[Context]) -> tuple[str, ...]:
        """See `mbtl.trainers.MeasuringTrainer`; `mbtl.envs.references` has what is unguided."""
        return ways_in(self.opener(contexts, 1)[0], contexts[0])

    def measure(
        self,
        policy: Any,
        contexts: Sequence[Context],
        seeds: Sequence[int] | int,
        names: Sequence[str] = (),
    ) -> dict[str, Array]:
        """What the `info` of the last steps tells; see `mbtl.trainers.MeasuringTrainer`.

        Episodes are played to their end also where their score is foretold.
        """
        return self._play(policy, contexts, seeds, names)[0]

    def _play(
        self,
        policy: Any,
        contexts: Sequence[Context],
        seeds: Sequence[int] | int,
        names: Sequence[str] = (),
    ) -> tuple[dict[str, Array], Array]:
        """See `mbtl.envs.references.played`."""
        each = episode_seeds(seeds, len(contexts), self.eval_episodes)
        with isolated(self.threads):
            at_once = min(len(contexts), self.n_eval_envs or EVALUATION_ENVS)
            make, most = self.opener(contexts, at_once)
            who = policy
            if not isinstance(policy, str):
                who = actor_for(policy, sampled=self.acting == "sampled")
            return played(make, who, contexts, each, names, score=self._score, max_envs=most)

    def save(self, policy: Any, folder: Path) -> bool:
        """Write the library's zip, and a numpy copy where there is one; no replay buffer."""
        save_sb3(policy, Path(folder))
        return True

    def load(self, folder: Path) -> Any:
        """Read the library's zip, which can execute code: only for files you trust (`load_sb3`)."""
        return load_sb3(folder, self.algorithm, self.device)

    @property
    def recipe(self) -> dict[str, Any]:
        """What decides the policies and their returns, JSON-able; not the place or speed."""
        return {
            "trainer": "stable-baselines3",
            "algorithm": described(self.algorithm),
            "policy": described(self.policy),
            **self._length_record,
            "hyperparameters": described(dict(sorted(self.hyperparameters.items()))),
            "n_envs": self.n_envs,
            "checkpoint": self.checkpoint,
            "checkpoint_every": self.checkpoint_every,
            "checkpoint_episodes": self.checkpoint_episodes,
            "eval_episodes": self.eval_episodes,
        }

    @property
    def functions(self) -> dict[str, Any]:
        """Where a user's own code is (`mbtl.trainers.contract.code_of`)."""
        return {"make_env": self.make_env, "policy": self.policy, "algorithm": self.algorithm}

    def opener(
        self, contexts: Sequence[Context], at_once: int
    ) -> tuple[Callable[[Context], Any], int]:
        """How environments of these contexts are opened, and how many of them at once.

        Raises:
            InvalidInput: as of `mbtl.envs.opening.once_per_process`.
        """
        from mbtl.envs.opening import once_per_process  # needs Gymnasium
        from mbtl.envs.remote import remote

        apart = self.apart
        if apart is None and at_once > 1:
            apart = once_per_process(self.make_env, contexts) is not None
        if not apart:
            return self.make_env, at_once
        return partial(remote, self.make_env), min(at_once, usable_cores())

    # ---- inside ------------------------------------------------------------------------------

    @property
    def _score(self) -> Score | None:
        return Score.of(self.score)

    def _look_at(self, context: Context) -> None:
        """Refuse an environment that nothing can be learnt in, before anything is trained."""
        from mbtl.envs.opening import is_same, refuse_running_statistics, watched_episode
        from mbtl.envs.recording import opened

        make = partial(self.make_env, dict(context))
        with opened(make) as (one,):
            refuse_running_statistics(one)
            same = False
            # a second one may be too much, which `once_per_process` finds out
            with suppress(Exception), opened(make) as (other,):
                same = is_same(one, other)
        if same:
            raise one_instance()
        with opened(make) as (env,):
            if not hasattr(env, "possible_agents"):
                watched_episode(env, 0, say=partial(warnings.warn, category=Notice, stacklevel=2))

    @property
    def _length_record(self) -> dict[str, Any]:
        """Settings that came later are named where they are used: old records stay as they were."""
        usual: dict[str, Any] = {
            **{"normalize_reward": False, "normalize_observations": False, "clip_actions": False},
            **{"credit": "own", "acting": "mean"},
        }
        now = {name: getattr(self, name) for name in usual}
        later = {name: value for name, value in now.items() if value != usual[name]}
        if self._score is not None:
            later["score"] = self._score.record
        return {"timesteps" if self.episodes is None else "episodes": self.whole, **later}

    def _algorithm(self) -> tuple[Any, dict[str, Any]]:
        """The library's class and its keyword arguments."""
        algorithm = algorithm_class(self.algorithm)
        return algorithm, checked_hyperparameters(algorithm, self.hyperparameters)

    def _model(
        self, kind: tuple[Any, dict[str, Any]], context: Context, seed: int, stack: ExitStack
    ) -> Any:
        """The library's model before its training."""
        algorithm, settings = kind
        envs = self._training_envs(context, stack)
        team = hasattr(envs, "slots")
        on_policy = "rollout_buffer_class" in inspect.signature(algorithm.__init__).parameters
        if self.credit == "team" and not (team and on_policy):
            raise InvalidInput(
                "credit='team' needs a PettingZoo parallel environment and an on-policy "
                f"algorithm, got {'' if team else 'no '}such environment and "
                f"{algorithm.__name__}; choose those, or credit='own'"
            )
        if team and on_policy and "rollout_buffer_class" not in settings:
            settings |= envs.rollout_buffer
        lengths = {name: _steps(value, envs, name) for name, value in settings.items()}
        with warnings.catch_warnings():
            if team or lengths != settings:  # minibatches of episodes are as they come
                warnings.filterwarnings("ignore", "You have specified a mini-batch size")
            model = algorithm(
                self._policy(on_policy), envs, seed=seed, device=self.device, verbose=0, **lengths
            )
        # explores with other numbers than those that the environments draw
        model.action_space.seed(action_seed(seed))
        log_nowhere(model)
        return model

    def _policy(self, on_policy: bool) -> str | type:
        if not (self.clip_actions and on_policy):
            return self.policy
        if self.policy != "MlpPolicy":
            raise InvalidInput(
                f"clip_actions=True goes with policy='MlpPolicy', got {self.policy!r}; a policy of "
                "your own can clip in its `forward`, as `mbtl.trainers.applied` does"
            )
        from mbtl.trainers.applied import AppliedMlpPolicy

        return AppliedMlpPolicy

    def _training_envs(self, context: Context, stack: ExitStack) -> Any:
        from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecNormalize

        from mbtl.envs.opening import refuse_running_statistics

        observed, rewarded = self.normalize_observations, self.normalize_reward
        several = self.checkpoint == "best" or (self.n_envs > 1 and not self.processes)
        open_env, _ = self.opener([context], 2 if several else 1)
        make = partial(self.make_env if self.processes else open_env, context)
        first = make()  # tells what it is; used where it is, as it cannot be sent to a process
        try:
            refuse_running_statistics(first)
        except InvalidInput:
            end(first)
            raise
        makers: list[Any] = [make] * self.n_envs
        if self.processes:
            end(first)
        else:
            makers[0] = lambda: first
        if hasattr(first, "possible_agents"):
            from mbtl.trainers.shared import SharedVecEnv

            if observed or rewarded:
                raise InvalidInput(
                    "what agents that come and go see and earn cannot be normalised, got "
                    f"normalize_reward={rewarded} and normalize_observations={observed}; scale it "
                    "in the environment"
                )
            envs: Any = SharedVecEnv(makers, processes=self.processes, credit=self.credit)
        else:
            monitored = [partial(_monitored, one) for one in makers]
            envs = SubprocVecEnv(monitored) if self.processes else DummyVecEnv(monitored)
        stack.callback(close, envs)
        if observed or rewarded:
            gamma = self.hyperparameters.get("gamma", 0.99)
            envs = VecNormalize(envs, norm_obs=observed, norm_reward=rewarded, gamma=gamma)
        return envs

    def _best_checkpoint(
        self, context: Context, seed: int, stack: ExitStack
    ) -> BestCheckpoint | None:
        if self.checkpoint == "final":
            return None
        count = min(self.checkpoint_episodes, self.n_eval_envs or EVALUATION_ENVS)
        envs = []
        open_env, _ = self.opener([context], count + 1)
        for _ in range(count):
            envs.append(open_env(context))
            stack.callback(end, envs[-1])
        seeds = checkpoint_seeds(seed, self.checkpoint_episodes)
        every = self.checkpoint_every or max(1, math.ceil(0.02 * self.whole))
        return BestCheckpoint(
            envs, seeds, every, sampled=self.acting == "sampled", score=self._score
        )


def _steps(value: Any, envs: Any, name: str) -> Any:
    """A hyperparameter, with `EPISODE` replaced by the steps of one."""
    if not (isinstance(value, str) and value == EPISODE):
        return value
    steps = envs.get_attr("episode_steps", [0])[0] if envs.has_attr("episode_steps") else None
    if steps is None:
        raise InvalidInput(
            f"{name}='{EPISODE}' needs an environment with an attribute episode_steps, got one "
            "without; give a number"
        )
    return steps


def _monitored(make: Callable[[], Any]) -> Any:
    from stable_baselines3.common.monitor import Monitor

    from mbtl.envs.spaces import Plain

    return Monitor(Plain(make()))
