"""Simulators that step whole batches on the host, as worlds of the engine.

    world = hosted(MyBatch())

A batch is numpy functions of any number of simulations. Within a compiled program each of them is
one call on the host for all policies, contexts and copies, while networks stay in the program: so
every learner, evaluation and file of the engine serves a native simulator as it is. States go in
and out as arrays; a simulator that keeps its own must be able to be set to one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, cast

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.arrays import Array
from mbtl.worlds.environments import Box, Discrete, Environment, Step, TimeLimit, Tree
from mbtl.worlds.world import Solo

State = Mapping[str, Array]
"""Arrays by name, with the axes of the batch first."""


class Batch(Protocol):
    """A native simulator of many simulations; hashable, as it is a compile-time constant.

    Axes of a batch, `...` below, come first in every array; parameters have all of them, too.

    Attributes:
        shapes: of a simulation's state by name, e.g. {"qpos": (3,)}, as pairs.
        horizon: steps after which an episode is cut off.
        time_limit: whether learning sees the cut-off as truncation or as a terminal state.
        action: the action space.
        n_features: length of an observation without visible context features.
        n_noise: uniform random numbers that start an episode.
        max_return: no episode can return more; None where that is not known.
        params: class of the parameters; its last field is `visible`.
    """

    @property
    def shapes(self) -> tuple[tuple[str, tuple[int, ...]], ...]: ...  # noqa: D102
    @property
    def horizon(self) -> int: ...  # noqa: D102
    @property
    def time_limit(self) -> TimeLimit: ...  # noqa: D102
    @property
    def action(self) -> Discrete | Box: ...  # noqa: D102
    @property
    def n_features(self) -> int: ...  # noqa: D102
    @property
    def n_noise(self) -> int: ...  # noqa: D102
    @property
    def max_return(self) -> float | None: ...  # noqa: D102
    @property
    def params(self) -> type[Any]: ...  # noqa: D102

    def initial(self, noise: Array, params: Any) -> tuple[State, Array]:
        """First states from (..., n_noise) uniform numbers, and what is seen, (..., n_features)."""
        ...

    def step(self, state: State, action: Array, params: Any) -> tuple[State, Array, Array, Array]:
        """States, observations, (...) rewards and whether each is terminal, after one step."""
        ...


class Shown(NamedTuple):
    """A simulation between two steps.

    Attributes:
        state: arrays by name.
        obs: (n_features,) what is seen of it.
    """

    state: Any
    obs: jax.Array


def hosted(batch: Batch) -> Solo:
    """The world of a batch."""
    return Solo(cast(Environment, Hosted(batch)))


@dataclass(frozen=True)
class Hosted:
    """An `Environment` whose simulations a batch steps on the host; what else it is, the batch is.

    Attributes:
        batch: the simulator.
    """

    batch: Batch

    def __getattr__(self, name: str) -> Any:
        if name == "batch" or name.startswith("__"):  # not there yet while it is unpickled
            raise AttributeError(name)
        return getattr(self.batch, name)

    def initial(self, noise: jax.Array, params: Tree) -> Shown:
        """First state."""
        return Shown(*_called(self.batch.initial, self._shown(), noise, params))

    def step(self, state: Shown, action: jax.Array, params: Tree) -> Step:
        """One step; one call for all simulations of the program."""
        scalars = (_shape((), np.float32), _shape((), np.bool_))
        kinds = (*self._shown(), *scalars)
        new, obs, reward, terminated = _called(self.batch.step, kinds, state.state, action, params)
        return Step(Shown(new, obs), reward, terminated)

    def restart(self, state: Shown, over: jax.Array, noise: jax.Array, params: Tree) -> Shown:
        """First states of the simulations that are over; those alone are started."""

        def some(state: Any, obs: Array, over: Array, noise: Array, params: Any) -> Any:
            if not over.any():
                return state, obs
            fresh = self.batch.initial(noise[over], jax.tree.map(lambda x: x[over], params))
            return jax.tree.map(lambda old, new: _put(old, over, new), (state, obs), fresh)

        return Shown(*_called(some, self._shown(), *state, over, noise, params))

    def observe(self, state: Shown, params: Tree) -> jax.Array:
        """What the batch showed, and the visible features."""
        return jnp.concatenate([state.obs, params.visible]).astype(jnp.float32)

    def _shown(self) -> tuple[Any, Any]:
        state = {name: _shape(shape, np.float32) for name, shape in self.batch.shapes}
        return state, _shape((self.batch.n_features,), np.float32)


def _called(function: Callable[..., Any], kinds: Any, *args: Any) -> Any:
    """What a function of numpy arrays gives, called once for all that is vectorised."""

    def on_host(*args: Any) -> Any:
        found = function(*jax.tree.map(np.asarray, args))
        return jax.tree.map(lambda x, kind: np.asarray(x, kind.dtype), found, kinds)

    return jax.pure_callback(on_host, kinds, *args, vmap_method="broadcast_all")


def _put(old: Array, at: Array, new: Array) -> Array:
    changed = np.array(old)
    changed[at] = new
    return changed


def _shape(shape: tuple[int, ...], dtype: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, dtype)
