"""Where a CMDP is simulated: step by step in Gymnasium or SUMO, or in jax for whole batches.

All take their physics from the same environment, so no constant is derived twice. "sumo-jax" is
SUMO with the learners of the jax engine: each simulation has a process of its own.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, ClassVar

from mbtl.contexts import Axis, Context
from mbtl.errors import ContextMismatch, missing_extra, unknown_name

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

    apart: ClassVar[bool] = False
    """They live side by side in one process; a second SUMO goes through TraCI."""

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
    """contexts -> world and parameters (`mbtl.engine.world_trainer.Problem`).

    Attributes:
        environment: "module:Class" of a `mbtl.engine.worlds.Environment` or, `on_host`, of a batch.
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
        from mbtl.engine import worlds

        options = self.make_env.options
        kind = resolved(self.environment)
        env = kind(horizon=options["horizon"], time_limit=options["time_limit"])
        world = worlds.hosted(env) if self.on_host else worlds.Solo(env)
        peers = [self.make_env(context) for context in contexts]
        visible = [peer.visible for peer in peers] or None
        return world, worlds.stack_params(world, [peer.constants for peer in peers], visible)


@dataclass(frozen=True)
class TwinProblem:
    """contexts -> traffic twin and parameters (`mbtl.engine.world_trainer.Problem`).

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


def _stacked(params: Sequence[Any]) -> Any:
    import jax
    import jax.numpy as jnp

    return jax.tree.map(lambda *each: jnp.stack(each), *params)
