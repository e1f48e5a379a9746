"""Where a CMDP is simulated: step by step in Gymnasium or SUMO, or in jax for whole batches.

All take their physics from the same environment, so no constant is derived twice. "sumo-jax" is
SUMO with the learners of the jax engine: each simulation has a process of its own.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from typing import Any, ClassVar, Literal

from mbtl.contexts import Axis, Context
from mbtl.errors import ContextMismatch, InvalidInput, missing_extra, unknown_name
from mbtl.score import Score

ENGINES = ("jax", "gymnasium", "sumo", "sumo-jax")

_EXTRAS = {"Box2D": "envs", "gymnasium": "envs", "mujoco": "envs", "pettingzoo": "traffic"}
"""Of packages that simulators need."""


def jax_is_installed() -> bool:
    """Whether the extra is there."""
    return all(find_spec(name) is not None for name in ("jax", "optax"))


def resolved(entry_point: str) -> Any:
    """What "module:Class" names.

    Raises:
        MissingExtra: a package that it needs is not installed.
    """
    try:
        return pkgutil.resolve_name(entry_point)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in _EXTRAS:
            raise
        raise missing_extra(package, _EXTRAS[package]) from error


@dataclass(frozen=True)
class EnvFactory:
    """context -> environment; can be sent to another process, imports the simulator when called.

    Attributes:
        entry_point: "module:Class".
        options: keyword arguments of the class.
        axes: what a context may set, and in which range; none: whatever the class takes.
    """

    entry_point: str
    options: Mapping[str, Any] = field(default_factory=dict)
    axes: tuple[Axis, ...] = ()

    def __call__(self, context: Mapping[str, Any]) -> Any:
        """A new environment.

        Raises:
            ContextMismatch: the context names no axis of this CMDP, or lies outside.
            MissingExtra: Gymnasium, or what the simulator needs, is not installed.
        """
        self.check(context)
        return resolved(self.entry_point)(context, **self.options)

    def check(self, context: Mapping[str, Any]) -> None:
        """Refuse what is no context of this CMDP; an axis may be left out, at its nominal value.

        Raises:
            ContextMismatch: as in `__call__`.
        """
        known = {axis.name: axis for axis in self.axes}
        for name, value in context.items() if known else ():
            if name not in known:
                raise ContextMismatch(str(unknown_name("axis", str(name), known)))
            known[name].encode([value])


@dataclass(frozen=True)
class JaxProblem:
    """contexts -> world and parameters (`mbtl.training.world_trainer.Problem`).

    Attributes:
        environment: "module:Class" of a `mbtl.worlds.Environment` or, `on_host`, of a batch.
        make_env: the Gymnasium environment of the same physics; its `constants` and `visible`
            become the parameters.
        on_host: a native simulator steps it.
    """

    environment: str
    make_env: EnvFactory
    on_host: bool = False

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, Any]:
        """The world, and the parameters of `contexts` with one leading axis.

        Raises:
            ContextMismatch: one of them names no axis of this CMDP, or lies outside.
            MissingExtra: jax, Gymnasium or the simulator is not installed.
        """
        from mbtl import worlds

        options = self.make_env.options
        kind = resolved(self.environment)
        env = kind(horizon=options["horizon"], time_limit=options["time_limit"])
        world = worlds.hosted(env) if self.on_host else worlds.Solo(env)
        peers = [self.make_env(context) for context in contexts]
        visible = [peer.visible for peer in peers] or None
        return world, worlds.stack_params(world, [peer.constants for peer in peers], visible)


@dataclass(frozen=True)
class TwinProblem:
    """contexts -> traffic twin and parameters (`mbtl.training.world_trainer.Problem`).

    Attributes:
        problem: "module:Class" of the family's record.
        make_env: the SUMO environment; the twin gets its switches.
        options: of the record beside those.
    """

    problem: str
    make_env: EnvFactory
    options: Mapping[str, Any] = field(default_factory=dict)

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, Any]:
        """The twin, and the parameters of `contexts` with one leading axis, None without any.

        Raises:
            ContextMismatch: one of them names no axis of this CMDP, or lies outside.
            MissingExtra: jax or Gymnasium is not installed.
        """
        for context in contexts:
            self.make_env.check(context)
        switches = {k: v for k, v in self.make_env.options.items() if k != "horizon"}
        record = pkgutil.resolve_name(self.problem)(**self.options, **switches)
        twin, params = record(contexts)
        return twin, _stacked(params) if params else None


@dataclass(frozen=True)
class SceneProblem:
    """contexts -> world of simulators in processes (`mbtl.training.world_trainer.Problem`).

    Attributes:
        make_env: context -> environment, of a function of a module or a record; a Gymnasium one, or
            a PettingZoo parallel one that has `most_agents`. It has `episode_steps`, and what it
            shows of the context is in its observations.
        time_limit: how learning sees the end of an episode.
        score: what an episode is worth; None: the sum of its rewards.
    """

    make_env: Callable[[Context], Any]
    time_limit: Literal["truncation", "terminal"] = "truncation"
    score: Score | None = None

    storable: ClassVar[bool] = False
    """A simulator lives in one process, so no file holds the state of a training."""

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, Any]:
        """The world, and the parameters of `contexts` with one leading axis.

        Raises:
            InvalidInput: there are no contexts, their numbers have different names, or the
                environments cannot be made elsewhere.
            MissingExtra: jax or the simulator is not installed.
        """
        from gymnasium.spaces import Discrete

        from mbtl import worlds
        from mbtl.envs.scene import EnvScene
        from mbtl.worlds.processes import Processes

        names = {tuple(sorted(context)) for context in contexts}
        if len(names) != 1:
            raise InvalidInput(
                f"simulators in processes take contexts with the same names, got {sorted(names)}"
            )
        (features,) = names
        envs = [self.make_env(context) for context in contexts]
        team = hasattr(envs[0], "possible_agents")
        seen, act = (
            (envs[0].observation_space(""), envs[0].action_space(""))
            if team
            else (envs[0].observation_space, envs[0].action_space)
        )
        places = envs[0].most_agents if team else 1
        world = Processes.of(
            partial(EnvScene, self.make_env, places, self.score),
            action=worlds.Discrete(int(act.n))
            if isinstance(act, Discrete)
            else worlds.Box(tuple(act.low.tolist()), tuple(act.high.tolist())),
            agents=places,
            n_features=int(seen.shape[0]),
            features=features,
            time_limit=self.time_limit,
            drives=hasattr(envs[0], "drive"),
        )
        constants = [
            {**context, "decisions": env.episode_steps}
            for context, env in zip(contexts, envs, strict=True)
        ]
        for env in envs:
            env.close()
        return world, worlds.stack_params(world, constants)

    @property
    def lanes(self) -> int:
        """Policies trained together: their episodes run at the same time."""
        return 1


def _stacked(params: Sequence[Any]) -> Any:
    import jax
    import jax.numpy as jnp

    return jax.tree.map(lambda *each: jnp.stack(each), *params)
