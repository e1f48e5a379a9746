"""What a learner asks of a twin: many simulations at once, each with agents that come and go.

Notation (shapes): n simulations, A agents of each at most, f numbers of an observation.

An episode is a fixed number of decisions. Between two of them a twin may simulate many steps. The
score of an episode, not the sum of its rewards, is the entry of a transfer matrix.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp

from mbtl.training.jax.environments import Box, Discrete, TimeLimit, Tree


class Seen(NamedTuple):
    """What the agents know when they decide.

    Attributes:
        obs: (n, A, f) float32.
        acting: (n, A) there is an agent, and it decides.
    """

    obs: jax.Array
    acting: jax.Array


class Moved(NamedTuple):
    """What happens until the next decision.

    Attributes:
        state: the next state.
        reward: (n, A), 0 where nobody acts.
        done: (n, A) the life of the agent has ended; the place may go to another one.
    """

    state: Tree
    reward: jax.Array
    done: jax.Array


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
"""Decisions of an episode; or, in contexts in which they last differently long, beats."""


class Twin(Protocol):
    """Dynamics of one context in n simulations; hashable, as it is a compile-time constant.

    Attributes:
        time_limit: whether learning sees an episode's end as truncation or as a terminal state.
        action: the action space of an agent.
        agents: A.
        n_features: length of an observation without visible context features.
        mixes: whether simulations of one batch may have contexts of their own, parameters (n, ...).
        params: class of the parameters; its last field is `visible`, (v,).
    """

    @property
    def time_limit(self) -> TimeLimit: ...  # noqa: D102
    @property
    def action(self) -> Discrete | Box: ...  # noqa: D102
    @property
    def agents(self) -> int: ...  # noqa: D102
    @property
    def n_features(self) -> int: ...  # noqa: D102
    @property
    def mixes(self) -> bool: ...  # noqa: D102
    @property
    def params(self) -> type[Any]: ...  # noqa: D102

    def decisions(self, params: Tree) -> Length:
        """Length of an episode in this context, or in these; not traced."""
        ...

    def start(self, seeds: jax.Array, params: Tree) -> Tree:
        """States at the first decision, after the warm-up, from (n,) uint32 seeds."""
        ...

    def observe(self, state: Tree, params: Tree) -> Seen:
        """What the agents know."""
        ...

    def step(self, state: Tree, action: jax.Array, params: Tree) -> Moved:
        """One decision; `action` is (n, A) integers, or (n, A, d) within the box."""
        ...

    def drive(self, state: Tree, params: Tree) -> Moved:
        """The same time without any advice."""
        ...

    def score(self, state: Tree) -> jax.Array:
        """(n,) matrix entry of episodes that have ended; larger is better."""
        ...


@runtime_checkable
class Holding(Twin, Protocol):
    """A twin in whose contexts decisions last differently long; in a batch they move in beats.

    A beat is a time of which all decisions are multiples. Between decisions an instruction holds.
    """

    def beats(self, params: Tree, beats: Beats) -> tuple[jax.Array, jax.Array]:
        """(n,) beats of one decision, and decisions of an episode."""
        ...

    def held(self, state: Tree) -> Tree:
        """Instructions before the first beat."""
        ...

    def beat(
        self, state: Tree, held: Tree, action: jax.Array, params: Tree, beats: Beats, now: jax.Array
    ) -> tuple[Moved, Tree]:
        """One beat; instructions are taken where a decision is due.

        `Moved` tells reward and end of a decision with its last beat. Whose episode is over stands
        still.
        """
        ...


@runtime_checkable
class Crowd(Twin, Protocol):
    """A twin of many agents that can show some of them: only those who act are looked at."""

    def acting(self, state: Tree) -> jax.Array:
        """(n, A) there is an agent, and it decides."""
        ...

    def views(
        self, state: Tree, params: Tree, simulation: jax.Array, place: jax.Array
    ) -> jax.Array:
        """(..., f) observations of the agents in some places, (...), of some simulations, (...)."""
        ...


def everyone(twin: Crowd, state: Tree, params: Tree) -> Seen:
    """What `Twin.observe` gives, in terms of `Crowd.views`."""
    acting = twin.acting(state)
    simulation, place = jnp.indices(acting.shape)
    return Seen(twin.views(state, params, simulation, place), acting)
