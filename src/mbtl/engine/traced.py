"""Simulators in jax of others as problems: gymnax, Brax, MuJoCo Playground, or your own.

    env, params = gymnax.make("Pendulum-v1")
    problem = jax_problem("pendulum", env, params, space, timesteps=100_000)

Whatever holds their parameters, jax knows them as one pytree. An axis names a leaf of it, "g" or
"opt.gravity[2]", and contexts are the values of the axes: an argument like any other, so that one
compiled program serves all. None of these packages is imported here; what is theirs is called.

Notation (shapes): k axes, v visible features, f numbers of an observation.
"""

from __future__ import annotations

from mbtl.engine.worlds import flags as flags  # isort: skip  # first: it starts jax
import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from pathlib import Path
from traceback import extract_tb
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.tree_util import keystr, tree_flatten_with_path

from mbtl.contexts import Categorical, Context, ContextSpace, Integer
from mbtl.engine.world_trainer import WorldTrainer
from mbtl.engine.worlds import Box, Discrete, Solo, Step, stack_params
from mbtl.engine.worlds.one import OneSimulation
from mbtl.errors import InvalidInput, check_known, few, unknown_name
from mbtl.plain import short, whole
from mbtl.problems import CMDP, Preset

Apply = Callable[[Any, Mapping[str, Any]], Any]
"""Parameters, and traced numbers by the names of the axes -> parameters in that context."""

_OURS = str(Path(__file__).parents[1])
"""Below it is no code of the user's."""
_OWN = ("reset", "step", "action", "horizon")
_LIMIT = "max_steps_in_episode"
_BRAX_STEPS = 1000
"""Steps of an episode where neither the environment nor the user says; Brax's own number."""
_MODELS = ("sys", "_mjx_model")
"""Where environments of Brax and of MuJoCo Playground keep their model."""


def with_fields(params: Any, values: Mapping[str, Any]) -> Any:
    """The parameters with other values in some of their fields; can be traced.

    Args:
        params: a pytree, e.g. gymnax's `EnvParams` or the `sys` of a Brax environment.
        values: numbers by field: a dotted path, and an index where only a part of an array is
            meant, "opt.gravity[2]" or "geom_friction[:,0]". One fills all that is named.

    Raises:
        UnknownName: there is no such field.
        InvalidInput: the field has no such part, or a value of another kind.
    """
    paths, tree = tree_flatten_with_path(params)
    leaves = {keystr(path, simple=True, separator="."): leaf for path, leaf in paths}
    for name, value in values.items():
        field, bracket, index = name.partition("[")
        if field not in leaves:
            known = few([*filter(None, leaves)], 9) or "none, see jax.tree_util.register_dataclass"
            hint = f"jax knows {known}. Axes that are no fields need apply=."
            raise unknown_name("parameter field", field, leaves, hint=hint)
        old, places = jnp.asarray(leaves[field]), index.removesuffix("]").split(",")
        part = np.zeros(old.shape, bool)
        try:
            part[tuple(slice(None) if p == ":" else int(p) for p in places if bracket)] = True
            new = jnp.where(part, value, old)
        except (IndexError, TypeError, ValueError):
            raise InvalidInput(
                "a field takes a number, and an index of numbers or ':' within its shape "
                f"{old.shape}, got {value!r} for {name!r}; without an index all of it is set"
            ) from None
        if old.dtype.kind in "iub" and new.dtype.kind == "f":
            raise InvalidInput(
                f"a field of whole numbers takes no fractions, got {value!r} for {name!r}; use "
                "mbtl.Integer, or parameters with a float there"
            )
        leaves[field] = new.astype(old.dtype)
    return jax.tree.unflatten(tree, leaves.values())


def jax_problem(
    id: str,
    env: Any,
    params: Any,
    space: ContextSpace,
    *,
    timesteps: int,
    apply: Apply = with_fields,
    horizon: int | None = None,
    show_context: bool = False,
    trainer_options: Mapping[str, Any] | None = None,
    budget: int | None = None,
    **record: Any,
) -> CMDP:
    """A problem from a simulator in jax, whose axes are fields of its parameters.

    A simulator of your own has, of one simulation that never starts again by itself,

        reset(key, params) -> (observation, state)
        step(key, state, action, params) -> (observation, state, reward, terminated)
        action         `Discrete` or `Box`
        horizon        steps after which an episode is cut off, which is no terminal state

    Args:
        id: short name, part of file names.
        env: an environment of gymnax, Brax or MuJoCo Playground without wrappers, or your own.
        params: its parameters, a pytree; None: gymnax's `env.default_params`, Brax's `env.sys`, or
            Playground's `env.mjx_model`.
        space: the contexts; an axis names a field by its dotted path, with an index where only a
            part of an array is meant: "g", "opt.gravity[2]", "geom_friction[:,0]".
        timesteps: environment steps of one training.
        apply: (params, context) -> params in jax, where axes are not fields.
        horizon: steps of an episode; None: as the environment says, and of Brax 1000.
        show_context: end each observation with the context, each axis from 0 to 1.
        trainer_options: of `WorldTrainer`, such as {"recipe_name": "sb3", "hyperparameters":
            {"gamma": 0.9}} for PPO as in Stable-Baselines3, where our recipe "fast" learns too
            little; 10 `eval_episodes` and the "final" checkpoint, where they do not say otherwise.
        budget: default number of trainings K; 10, or N if that is smaller.
        **record: further fields of `mbtl.CMDP`, e.g. `bounds`, `nominal`, `presets`.

    Raises:
        UnknownName: an axis is no field of the parameters.
        InvalidInput: an axis cannot be one, or `env` is none of these or cannot be traced.
    """
    for axis in space.axes:
        if isinstance(axis, Categorical) and any(isinstance(one, str) for one in axis.choices):
            raise InvalidInput(
                f"an axis in jax is of numbers, got {short(axis.choices)} for {axis.name!r}; "
                f"number them, as in mbtl.Categorical({axis.name!r}, (0, 1)); apply= may translate"
            )
    model = next((name for name in _MODELS if hasattr(env, name)), "default_params")
    given = getattr(env, model, None) if params is None else params
    ends = {int(i) for column in space.unit.T for i in (column.argmin(), column.argmax())}
    extremes = [apply(given, space.context(i)) for i in sorted(ends)]
    reset, step, action, steps = _functions(env, model, given, extremes)
    axes = tuple((axis.name, isinstance(axis, Integer)) for axis in space.axes)
    most = whole("horizon of a simulator", steps if horizon is None else horizon, 1)
    simulated = Simulated(reset, step, action, most, given, axes, apply)
    problem = JaxProblem(Solo(cast(Any, simulated)), space, show_context)
    _check_traced(problem)
    options = {"eval_episodes": 10, "checkpoint": "final", **(trainer_options or {})}
    known = {one.name for one in fields(WorldTrainer)} - {"problem", "timesteps"}
    for name in options:
        check_known("trainer option", name, known)
    trainer = WorldTrainer(problem, timesteps=timesteps, **options)
    shown = {"visibility": "cube" if show_context else "hidden"}
    record["settings"] = {**shown, **record.get("settings", {})}
    if budget is not None:
        record.setdefault("presets", {"default": Preset(budget)})
    return CMDP(id, space, trainer, make_env=problem.env, horizon=simulated.horizon, **record)


# ---- as a world ----------------------------------------------------------------------------------


class Values(NamedTuple):
    """One context: (k,) of the axes, and the (v,) visible features."""

    axes: jax.Array
    visible: jax.Array


class Lived(NamedTuple):
    """A simulation between two steps: (2,) its key, the next moment, its state and what is seen."""

    key: jax.Array
    moment: jax.Array
    state: Any
    obs: jax.Array


@dataclass(frozen=True, eq=False)
class Simulated:
    """An `Environment` of the functions of a simulator; programs know it by its identity.

    Attributes:
        first: `reset` of the simulator.
        following: `step` of the simulator.
        action: what the agent may do, in all contexts.
        horizon: steps of an episode.
        template: parameters, of which a context changes some.
        axes: their names, and whether an axis is of whole numbers.
        apply: how a context changes them.
    """

    first: Callable[..., Any]
    following: Callable[..., Any]
    action: Discrete | Box
    horizon: int
    template: Any
    axes: tuple[tuple[str, bool], ...]
    apply: Apply
    time_limit: str = "truncation"
    n_noise: int = 2
    max_return: float | None = None
    params: type[Values] = Values

    @cached_property
    def n_features(self) -> int:
        """Numbers of an observation, whatever its shape."""
        nowhere = Values(jnp.zeros(len(self.axes)), jnp.zeros(0))
        return int(jax.eval_shape(self.initial, jnp.zeros(self.n_noise), nowhere).obs.size)

    def initial(self, noise: jax.Array, params: Values) -> Lived:
        """First state; the bits of the noise are the key of all that is random in the episode."""
        bits = jax.lax.bitcast_convert_type(noise.astype(jnp.float32), jnp.uint32)
        key = jax.random.fold_in(jax.random.PRNGKey(bits[0]), bits[1])
        obs, state, *_ = self.first(jax.random.fold_in(key, 0), self.at(params))
        return Lived(key, jnp.int32(1), jax.tree.map(jnp.asarray, state), ravel_pytree(obs)[0])

    def step(self, state: Lived, action: jax.Array, params: Values) -> Step:
        """One step; where nothing is random in it, its key is never computed."""
        key = jax.random.fold_in(state.key, state.moment)
        obs, new, reward, over, *_ = self.following(key, state.state, action, self.at(params))
        lived = Lived(state.key, state.moment + 1, new, ravel_pytree(obs)[0])
        return Step(lived, jnp.asarray(reward).reshape(()), jnp.asarray(over, bool).reshape(()))

    def observe(self, state: Lived, params: Values) -> jax.Array:
        """What the simulator showed, and the visible features."""
        return jnp.concatenate([state.obs, params.visible]).astype(jnp.float32)

    def at(self, params: Values) -> Any:
        """The simulator's parameters in a context."""
        pairs = zip(self.axes, params.axes, strict=True)
        there = {name: x.astype(int) if whole else x for (name, whole), x in pairs}
        return self.apply(self.template, there)


@dataclass(frozen=True, eq=False)
class JaxProblem:
    """contexts -> world and its parameters (`mbtl.engine.world_trainer.Problem`).

    Attributes:
        world: of all contexts.
        space: of the contexts.
        show_context: it is in the observations.
    """

    world: Solo
    space: ContextSpace
    show_context: bool

    def __call__(self, contexts: Sequence[Context]) -> tuple[Solo, Any]:
        """The world, and the parameters of `contexts` with one leading axis."""
        rows = [{"axes": [context[a.name] for a in self.space.axes]} for context in contexts]
        visible = [self.space.encode(context) for context in contexts if self.show_context]
        return self.world, stack_params(self.world, rows, visible or None)

    def env(self, context: Context) -> OneSimulation:
        """One simulation as a Gymnasium environment."""
        return OneSimulation(*self([context]))


def _check_traced(problem: JaxProblem) -> None:
    """As it will be: vectorised, in a loop; jax says in its own words what does not go."""
    seeds = jnp.zeros(1, jnp.uint32)

    def one(state: Any, moment: jax.Array) -> tuple[Any, None]:
        return world.step(state, world.any_actions(seeds, moment), params).state, None

    try:
        world, params = problem([problem.space.context(0)])
        jax.eval_shape(lambda: jax.lax.scan(one, world.start(seeds, params), jnp.arange(2)))
    except (TypeError, ValueError, AttributeError, LookupError) as error:
        frames = [at for at in extract_tb(error.__traceback__) if "-packages" not in at.filename]
        own = [f"{at.filename}:{at.lineno}" for at in frames if not at.filename.startswith(_OURS)]
        where = f" at {own[-1]}" if own else ""
        raise InvalidInput(
            "jax traces a simulator: no Python `if` on its numbers (jnp.where instead); reset "
            "gives (observation, state), which keep their shapes and types; got one that fails"
            f"{where}: {' '.join(str(error).split())[:300]}"
        ) from error


# ---- whose simulators ----------------------------------------------------------------------------


def _functions(env: Any, model: str, params: Any, extremes: Sequence[Any]) -> tuple[Any, ...]:
    """`reset` and `step` as in `jax_problem`, actions, and steps of an episode."""
    if all(hasattr(env, name) for name in _OWN):
        return env.reset, env.step, env.action, env.horizon
    if hasattr(env, "step_env") and not hasattr(env, "_env"):
        action = _widest([env.action_space(there) for there in extremes])
        return env.reset_env, partial(_gymnax_step, env), action, getattr(params, _LIMIT)
    if model in _MODELS and getattr(env, "unwrapped", env) is env:
        box = Box((-1.0,) * env.action_size, (1.0,) * env.action_size)
        steps = getattr(env, "_config", {}).get("episode_length", _BRAX_STEPS)
        return partial(_brax, env, model), partial(_brax, env, model), box, steps
    raise InvalidInput(
        "a simulator is an environment of gymnax, Brax or Playground without wrappers, or has "
        f"{', '.join(_OWN)}, got a {type(env).__name__}; see mbtl.engine.jax_problem"
    )


def _gymnax_step(env: Any, key: jax.Array, state: Any, action: jax.Array, params: Any) -> Any:
    """Without auto-reset; before gymnax 1.0 `done` is also that time is up, which is no end."""
    obs, new, reward, done, _ = env.step_env(key, state, action, params)
    if not hasattr(env, "is_truncated"):
        done = done & (new.time < getattr(params, _LIMIT))
    return obs, new, reward, done


def _widest(theirs: Sequence[Any]) -> Discrete | Box:
    """Actions of gymnax in all contexts; the environment clips those of a box."""
    if hasattr(theirs[0], "n"):
        return Discrete(int(theirs[0].n))
    low = np.min([np.broadcast_to(one.low, one.shape) for one in theirs], axis=0)
    high = np.max([np.broadcast_to(one.high, one.shape) for one in theirs], axis=0)
    return Box(tuple(low.ravel().tolist()), tuple(high.ravel().tolist()))


def _brax(env: Any, model: str, key: jax.Array, *given: Any) -> Any:
    """`reset` where only parameters are given, else `step`, whose state has a key of its own.

    The model is set on a copy, as the environment belongs to the user.
    """
    *now, params = given
    env = copy.copy(env)
    setattr(env, model, params)
    state = env.step(*now) if now else env.reset(key)
    sides = isinstance(state.obs, Mapping) and "state" in state.obs  # else only for critics
    return state.obs["state"] if sides else state.obs, state, state.reward, state.done
