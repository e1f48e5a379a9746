"""Simulators that have a process each, as a world: SUMO, or any environment of a user's.

    world = Processes.of(make_scene, action=..., agents=..., n_features=..., features=("hold",))

A scene is one simulation with places for its agents. Within a compiled program every decision is
one call on the host, for all simulations: they are all asked, then all waited for, so that they run
side by side. Networks, learners and evaluation stay those of the engine.

What simulators remember stays in their processes: a training that is interrupted begins again. One
that fails is not a number from then on, with which no training goes on and no evaluation ends.
"""

from __future__ import annotations

import functools
import os
import pickle
import warnings
from collections import namedtuple
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import io_callback

from mbtl.engine.scene import EnvScene, Sight, ask
from mbtl.engine.worlds.environments import Box, Discrete, TimeLimit, Tree
from mbtl.engine.worlds.world import Moved, Seeded, Seen
from mbtl.errors import InvalidInput
from mbtl.processes import SeparateWorkers

MOST = 32
"""Simulations at once: so many processes, of 100 MB or so each."""


class Live(NamedTuple):
    """n simulations between two decisions.

    Attributes:
        number: (n,) of their processes.
        obs: (n, A, f) float32, see `Sight`.
        acting: (n, A)
        over: (n,)
        score: (n,)
        left: decisions until the longest episode of these ends at the latest.
    """

    number: jax.Array
    obs: jax.Array
    acting: jax.Array
    over: jax.Array
    score: jax.Array
    left: jax.Array


@dataclass(frozen=True)
class Processes(Seeded):
    """n scenes, each in a process of its own.

    Attributes:
        scene: makes an `EnvScene`, pickled: what is pickled alike is the same world, compiled once.
        action: the action space of an agent.
        agents: A.
        n_features: length of an observation, with whatever it shows of the context.
        features: names of the numbers that a scene's context has.
        time_limit: whether learning sees an episode's end as truncation or as a terminal state.
        drives: whether a scene goes on without any action.
        most: simulations at once.
    """

    scene: bytes
    action: Discrete | Box
    agents: int
    n_features: int
    features: tuple[str, ...]
    time_limit: TimeLimit = "truncation"
    drives: bool = True
    most: int = MOST

    storable: ClassVar[bool] = False

    @classmethod
    def of(cls, make_scene: Callable[[], EnvScene], **fields: Any) -> Processes:
        """The world of these scenes; other fields by name.

        Raises:
            InvalidInput: the scenes cannot be made in another process.
        """
        try:
            return cls(pickle.dumps(make_scene), **fields)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise InvalidInput(
                "simulators in other processes are made by what can be sent there, a function of "
                f"a module for example, got {make_scene!r}: {error}"
            ) from error

    @property
    def params(self) -> type[Any]:
        """Fields: the features, `decisions` of an episode at most, and nothing visible."""
        return _params(self.features)

    def decisions(self, params: Tree) -> int:
        """Of the longest episode; others end when they end."""
        return int(np.max(np.asarray(params.decisions)))

    def start(self, drawn: jax.Array, params: Tree) -> Live:
        """First states, from (n,) seeds.

        Raises:
            InvalidInput: more simulations than there may be processes.
        """
        n = len(drawn)
        if n > self.most:
            raise InvalidInput(
                f"a simulator with a process of its own runs at most {self.most} times at once, "
                f"got {n} episodes; train fewer policies together (lanes), on fewer episodes each"
            )
        contexts = [jnp.broadcast_to(getattr(params, name), (n,)) for name in self.features]
        kinds = (jax.ShapeDtypeStruct((n,), jnp.int32), *self._kinds(n))
        shown = io_callback(self._begin, kinds, drawn, *contexts)
        left = jnp.max(jnp.asarray(params.decisions)).astype(jnp.int32)
        return Live(*(*shown, left))

    def observe(self, state: Live, params: Tree) -> Seen:
        """What is seen; who was cut off counts at the end of the longest episode only."""
        cut_off = state.over & (state.left > 0)
        return Seen(state.obs, state.acting & ~cut_off[:, None])

    def step(self, state: Live, action: jax.Array | None, params: Tree) -> Moved:
        """One decision of all simulations that go on."""
        n = len(state.over)
        none = jax.ShapeDtypeStruct((n, self.agents), jnp.float32)
        ended = jax.ShapeDtypeStruct((n, self.agents), jnp.bool_)
        given = () if action is None else (action,)
        found = io_callback(self._on, (*self._kinds(n), none, ended), *state[:-1], *given)
        *shown, reward, done = found
        return Moved(Live(*(state.number, *shown, state.left - 1)), reward, done)

    def drive(self, state: Live, params: Tree) -> Moved:
        """The same without any action."""
        return self.step(state, None, params)

    def over(self, state: Live) -> jax.Array:
        """The simulator says so."""
        return state.over

    def score(self, state: Live) -> jax.Array:
        """What the simulators say."""
        return state.score

    # ---- on the host -------------------------------------------------------------------------

    def _begin(self, seeds: Any, *contexts: Any) -> tuple[Any, ...]:
        rows = zip(*(map(_decimal, np.asarray(column)) for column in contexts), strict=True)
        named = [dict(zip(self.features, row, strict=True)) for row in rows]
        crew = self._crew(len(named))
        told = zip(crew, named, np.asarray(seeds).tolist(), strict=True)
        asked = [one.submit(ask, self.scene, "start", context, seed) for one, context, seed in told]
        sights = [_answer(each) or self._lost() for each in asked]
        obs, acting, over, score = map(np.array, zip(*sights, strict=True))
        return np.arange(len(crew), dtype=np.int32), obs, acting, over, score.astype(np.float32)

    def _on(
        self, number: Any, obs: Any, acting: Any, over: Any, score: Any, action: Any = None
    ) -> tuple[Any, ...]:
        """What is shown after a decision of those that are not over; rewards, and ended lives."""
        obs, acting, over, score = map(np.array, (obs, acting, over, score))
        reward, done = np.zeros(acting.shape, np.float32), np.zeros(acting.shape, bool)
        crew = self._crew(len(over))
        told = [None] * len(over) if action is None else np.asarray(action)
        going = np.flatnonzero(~over).tolist()
        asked = {i: crew[i].submit(ask, self.scene, "step", told[i]) for i in going}
        for i, each in asked.items():
            found = _answer(each)
            sight, reward[i], done[i] = found if found is not None else (self._lost(), np.nan, True)
            obs[i], acting[i], over[i], score[i] = sight
        return obs, acting, over, score, reward, done

    def _crew(self, n: int) -> Sequence[SeparateWorkers]:
        crew = _crew(self.scene, os.getpid())
        crew.extend(SeparateWorkers(1) for _ in range(n - len(crew)))
        return crew[:n]

    def _kinds(self, n: int) -> tuple[jax.ShapeDtypeStruct, ...]:
        return (
            jax.ShapeDtypeStruct((n, self.agents, self.n_features), jnp.float32),
            jax.ShapeDtypeStruct((n, self.agents), jnp.bool_),
            jax.ShapeDtypeStruct((n,), jnp.bool_),
            jax.ShapeDtypeStruct((n,), jnp.float32),
        )

    def _lost(self) -> Sight:
        """Not a number, and somebody has to learn from it."""
        obs = np.full((self.agents, self.n_features), np.nan, np.float32)
        return obs, np.ones(self.agents, bool), True, np.nan


@functools.lru_cache(maxsize=4)
def _crew(scene: bytes, owner: int) -> list[SeparateWorkers]:
    """Processes of a world, as many as were ever needed; those of its master are not a child's."""
    return []


@functools.cache
def _params(features: tuple[str, ...]) -> type[Any]:
    return namedtuple("SceneParams", (*features, "decisions", "visible"))


def _answer(asked: Future[Any]) -> Any:
    """What a scene gave; None where its simulator failed or its process died."""
    try:
        return asked.result()
    except Exception as error:  # a stranger's simulator may raise anything
        warnings.warn(f"a simulation failed, so its training fails, too: {error}", RuntimeWarning,
                      stacklevel=2)  # fmt: skip
        return None


def _decimal(value: Any) -> float:
    """The number as it was written, which float32 only comes near to."""
    return float(str(np.float32(value)))
