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

import math
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
    given, taken = _Packing.of(args), _Packing.of(kinds)

    def on_host(packed: Any) -> Any:
        packed = np.asarray(packed)
        return taken.packed(function(*given.apart(packed)), np, packed.shape[:-1])

    kind = _shape((taken.total,), np.float32)
    packed = given.packed(args, jnp, ())
    return taken.apart(jax.pure_callback(on_host, kind, packed, vmap_method="broadcast_all"))


@dataclass(frozen=True)
class _Packing:
    """Arrays in a tree as one array: what they have in common first, then all numbers of each.

    Attributes:
        tree: structure.
        shapes: of the arrays.
        dtypes: likewise.
    """

    tree: Any
    shapes: tuple[tuple[int, ...], ...]
    dtypes: tuple[Any, ...]

    @classmethod
    def of(cls, arrays: Any) -> _Packing:
        """As these are, without axes in common."""
        leaves, tree = jax.tree.flatten(arrays)
        return cls(tree, tuple(x.shape for x in leaves), tuple(x.dtype for x in leaves))

    @property
    def total(self) -> int:
        """Numbers in all arrays together."""
        return sum(map(math.prod, self.shapes))

    def packed(self, arrays: Any, numpy: Any, axes: tuple[int, ...]) -> Any:
        """One array (*axes, total) of arrays whose first axes are `axes`."""
        each = [
            numpy.asarray(x).reshape(*axes, math.prod(shape)).astype(np.float32)
            for x, shape in zip(jax.tree.leaves(arrays), self.shapes, strict=True)
        ]
        return numpy.concatenate(each, axis=-1)

    def apart(self, packed: Any) -> Any:
        """The arrays again, of NumPy or jax as `packed` is."""
        first, leaves = 0, []
        for shape, dtype in zip(self.shapes, self.dtypes, strict=True):
            part = packed[..., first : first + math.prod(shape)]
            leaves.append(part.reshape(*packed.shape[:-1], *shape).astype(dtype))
            first += math.prod(shape)
        return jax.tree.unflatten(self.tree, leaves)


def _shape(shape: tuple[int, ...], dtype: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, dtype)
