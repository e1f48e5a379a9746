"""Simulators that step whole batches on the host, as worlds of the engine.

    world = hosted(MyBatch())

A batch is numpy functions of any number of simulations. Within a compiled program each of them is
one call on the host for all policies, contexts and copies, while networks stay in the program: so
every learner, evaluation and file of the engine serves a native simulator as it is. States go in
and out as arrays. A simulator that keeps its own must be able to be set to one.

All numbers of a call travel in one array of float32, each way: jax spends most of a call on its
arrays, whatever their size. So whole numbers are exact up to 2^24.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, cast

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.arrays import Array
from mbtl.engine.worlds.environments import Environment, OfOneAgent, Step, Tree
from mbtl.engine.worlds.world import Solo

State = Mapping[str, Array]
"""Arrays by name, with the axes of the batch first."""


class Batch(OfOneAgent, Protocol):
    """A native simulator of many simulations.

    Axes of a batch, `...` below, come first in every array; parameters have all of them, too.

    Attributes:
        shapes: of a simulation's state by name, e.g. {"qpos": (3,)}, as pairs.

    Where first states are simple, `initial` may be written in jax for one simulation, which saves a
    call at every step; `traced_start = True` says so.
    """

    @property
    def shapes(self) -> tuple[tuple[str, tuple[int, ...]], ...]: ...  # noqa: D102

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
        if getattr(self.batch, "traced_start", False):
            return Shown(*self.batch.initial(noise, params))
        return Shown(*_called(self.batch.initial, self._shown(), noise, params))

    def step(self, state: Shown, action: jax.Array, params: Tree) -> Step:
        """One step; one call for all simulations of the program."""
        scalars = (_shape((), np.float32), _shape((), np.bool_))
        kinds = (*self._shown(), *scalars)
        new, obs, reward, terminated = _called(self.batch.step, kinds, state.state, action, params)
        return Step(Shown(new, obs), reward, terminated)

    def observe(self, state: Shown, params: Tree) -> jax.Array:
        """What the batch showed, and the visible features."""
        return jnp.concatenate([state.obs, params.visible]).astype(jnp.float32)

    def _shown(self) -> tuple[Any, Any]:
        state = {name: _shape(shape, np.float32) for name, shape in self.batch.shapes}
        return state, _shape((self.batch.n_features,), np.float32)


def _called(function: Callable[..., Any], kinds: Any, *args: Any) -> Any:
    """What a function of numpy arrays gives, called once for all that is vectorised."""
    given = jax.tree.map(lambda x: _shape(x.shape, x.dtype), args)

    def on_host(packed: Any) -> Any:
        packed = np.asarray(packed)
        return _packed(function(*_apart(packed, given)), kinds, np, packed.shape[:-1])

    total = sum(kind.size for kind in jax.tree.leaves(kinds))
    packed, whole = _packed(args, given, jnp, ()), _shape((total,), np.float32)
    return _apart(jax.pure_callback(on_host, whole, packed, vmap_method="broadcast_all"), kinds)


def _packed(arrays: Any, kinds: Any, numpy: Any, axes: tuple[int, ...]) -> Any:
    """Arrays in a tree as one, (*axes, total): the axes in common, then all numbers of each."""
    pairs = zip(jax.tree.leaves(arrays), jax.tree.leaves(kinds), strict=True)
    each = [numpy.asarray(x).reshape(*axes, kind.size).astype(np.float32) for x, kind in pairs]
    return numpy.concatenate(each, axis=-1)


def _apart(packed: Any, kinds: Any) -> Any:
    """The arrays again, of NumPy or jax as `packed` is."""
    leaves, tree = jax.tree.flatten(kinds)
    parts, first = [], 0
    for kind in leaves:
        part = packed[..., first : first + kind.size]
        parts.append(part.reshape(*packed.shape[:-1], *kind.shape).astype(kind.dtype))
        first += kind.size
    return jax.tree.unflatten(tree, parts)


def _shape(shape: tuple[int, ...], dtype: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, dtype)
