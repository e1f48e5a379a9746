"""One simulation with one agent: pure functions of a state and of context parameters.

`world.Solo` makes many of them a world. Parameters are arguments and never closed over. A
state knows no time limit and never resets itself: whoever steps it counts the steps, tells
truncation from termination and starts anew.

Parameters are a NamedTuple of arrays: the constants that the Gymnasium environment of the same name
derives from its features, then `visible`, the context features appended to each observation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import jax
import jax.numpy as jnp

TimeLimit = Literal["truncation", "terminal"]

Tree = Any
"""Arrays in nested tuples, lists or dictionaries: what jax calls a pytree."""


class Beats(NamedTuple):
    """Length of episodes in contexts whose decisions last differently long.

    Attributes:
        decisions: of the episode that has most.
        total: beats of the longest episode.
        steps: simulation steps of a beat.
    """

    decisions: int
    total: int
    steps: int


Length = int | Beats
"""Decisions of an episode; or, of several contexts in which they last differently long, beats."""


@dataclass(frozen=True)
class Discrete:
    """Actions 0..n-1."""

    n: int


@dataclass(frozen=True)
class Box:
    """Actions are vectors within bounds, one entry of `low` and `high` per dimension."""

    low: tuple[float, ...]
    high: tuple[float, ...]


class Law(NamedTuple):
    """Actions of one kind as those of another: scale x action + gain x obs[feature], in a box."""

    scale: float
    feature: int
    gain: float
    box: Box


class Step(NamedTuple):
    """What one step gives.

    Attributes:
        state: the next state, also after a terminal step.
        reward: scalar.
        terminated: the state is terminal; the time limit does not count.
    """

    state: Tree
    reward: jax.Array
    terminated: jax.Array


class Described(Protocol):
    """What is fixed about a kind of simulation; hashable, as it is a compile-time constant.

    Attributes:
        time_limit: whether learning sees an episode's end as truncation or as a terminal state.
        action: the action space of an agent.
        n_features: length of an observation without visible context features.
        max_return: no episode is worth more; None where that is not known.
        params: class of the parameters; its last field is `visible`, (v,) or (n, v).
    """

    @property
    def time_limit(self) -> TimeLimit: ...  # noqa: D102
    @property
    def action(self) -> Discrete | Box: ...  # noqa: D102
    @property
    def n_features(self) -> int: ...  # noqa: D102
    @property
    def max_return(self) -> float | None: ...  # noqa: D102
    @property
    def params(self) -> type[Any]: ...  # noqa: D102


class OfOneAgent(Described, Protocol):
    """What is fixed about a simulation of one agent.

    Attributes:
        horizon: steps after which an episode is cut off.
        n_noise: uniform random numbers that start an episode.
    """

    @property
    def horizon(self) -> int: ...  # noqa: D102
    @property
    def n_noise(self) -> int: ...  # noqa: D102


class Environment(OfOneAgent, Protocol):
    """Dynamics of one simulation; with an action `idle` that is none, it goes on without advice."""

    def initial(self, noise: jax.Array, params: Tree) -> Tree:
        """First state from `noise`, (n_noise,) uniform in [0, 1)."""
        ...

    def step(self, state: Tree, action: jax.Array, params: Tree) -> Step:
        """One step; `action` is an integer, or a vector within the box."""
        ...

    def observe(self, state: Tree, params: Tree) -> jax.Array:
        """(n_features + visible,) float32, what the policy sees."""
        ...


def stack_observation(parts: Sequence[jax.Array], visible: jax.Array) -> jax.Array:
    """Observation from its scalars and the visible features."""
    return jnp.concatenate([jnp.stack(list(parts)), visible]).astype(jnp.float32)
