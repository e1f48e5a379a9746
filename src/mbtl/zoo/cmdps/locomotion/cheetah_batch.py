"""Many half cheetahs, each in a context of its own, stepped together by MuJoCo.

`mujoco.batch` keeps fields of the model per simulation and steps all of them on its threads; its
results do not depend on their number. What a simulation is between two actions goes in and out as
numbers: positions without the way run, on which nothing depends, speeds, and the accelerations from
which MuJoCo's solver starts.
"""

from __future__ import annotations

import functools
import threading
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtri
from mujoco.batch import Batch

from mbtl.arrays import Array
from mbtl.engine.worlds import Box
from mbtl.processes import native_threads
from mbtl.zoo.cmdps.contextual import TimeLimit
from mbtl.zoo.cmdps.locomotion import cheetah
from mbtl.zoo.cmdps.locomotion.cheetah import MOTORS, SUBSTEPS, base_model

_N_STATE = cheetah.N_FEATURES + cheetah.N_POSITIONS
_MOTORS = Box((-1.0,) * cheetah.N_MOTORS, (1.0,) * cheetah.N_MOTORS)


class CheetahParams(NamedTuple):
    """`cheetah.Constants`, and what a policy sees of the context."""

    gravity: Any
    friction: Any
    stiffness: Any
    visible: Any


@dataclass(frozen=True)
class HalfCheetahs:
    """`cheetah.HalfCheetah` in batches (`mbtl.engine.worlds.hosted.Batch`)."""

    horizon: int = 1000
    time_limit: TimeLimit = "truncation"
    action: Box = _MOTORS
    idle: tuple[float, ...] = (0.0,) * cheetah.N_MOTORS

    shapes: ClassVar[tuple[tuple[str, tuple[int, ...]], ...]] = (("physics", (_N_STATE,)),)
    n_features: ClassVar[int] = cheetah.N_FEATURES
    n_noise: ClassVar[int] = cheetah.N_NOISE
    max_return: ClassVar[float | None] = None
    params: ClassVar[type[CheetahParams]] = CheetahParams
    traced_start: ClassVar[bool] = True

    def initial(
        self, noise: jax.Array, params: CheetahParams
    ) -> tuple[dict[str, jax.Array], jax.Array]:
        """`cheetah.first_state` of one simulation, in jax."""
        n = cheetah.N_POSITIONS
        place, speed = cheetah.first_state(noise, jnp, ndtri)
        seen = jnp.concatenate([place[1:], speed])
        return {"physics": jnp.concatenate([seen, jnp.zeros(n)])}, seen

    def step(
        self, state: Any, action: Array, params: CheetahParams
    ) -> tuple[dict[str, Array], Array, Array, Array]:
        """One action of every simulation; what is not a number stays so."""
        physics = state["physics"]
        axes = physics.shape[:-1]
        physics, action = physics.reshape(-1, _N_STATE), action.reshape(-1, cheetah.N_MOTORS)
        constants = np.stack([np.reshape(x, -1) for x in params[:-1]], axis=-1)
        physics, moved = _cheetahs(len(physics)).step(physics, action, constants)
        reward = moved / cheetah.STEP - cheetah.ACTION_COST * np.square(action).sum(axis=-1)
        physics = physics.reshape(*axes, _N_STATE)
        ended = np.zeros(axes, bool)
        return {"physics": physics}, physics[..., : self.n_features], reward.reshape(axes), ended


class _Cheetahs:
    """Room for n simulations."""

    def __init__(self, n: int) -> None:
        self._batch = Batch(base_model(), n, native_threads())
        bind, expand = self._batch.bind, self._batch.expand
        self._place, self._speed, self._start, self._motor = map(
            bind, ("qpos", "qvel", "qacc_warmstart", "ctrl")
        )
        self._gravity, self._friction, self._stiffness = map(
            expand, ("opt.gravity", "geom_friction", "jnt_stiffness")
        )
        self._constants = np.full((n, 3), np.nan)
        self._alone = threading.Lock()

    def step(self, physics: Array, action: Array, constants: Array) -> tuple[Array, Array]:
        """(n, 26) states after an action, and the (n,) way run."""
        n = cheetah.N_POSITIONS
        with self._alone:
            self._set(constants)
            self._place[:, 0], self._place[:, 1:] = 0.0, physics[:, : n - 1]
            self._speed[...], self._start[...] = physics[:, n - 1 : -n], physics[:, -n:]
            self._motor[...] = action
            self._batch.step(nstep=SUBSTEPS)
            now = (self._place[:, 1:], self._speed, self._start)
            return np.concatenate(now, axis=1), self._place[:, 0].copy()

    def _set(self, constants: Array) -> None:
        if np.array_equal(constants, self._constants):
            return
        self._constants[...] = constants
        gravity, friction, stiffness = constants.T
        self._gravity[:, 2] = -gravity
        self._friction[:, :, 0] = friction[:, None]
        self._stiffness[:, MOTORS] = stiffness[:, None] * base_model().jnt_stiffness[MOTORS]


@functools.lru_cache(maxsize=16)
def _cheetahs(n: int) -> _Cheetahs:
    return _Cheetahs(n)
