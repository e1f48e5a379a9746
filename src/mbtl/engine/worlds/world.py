"""What learners ask of a world: many simulations at once, each with agents that come and go.

Notation (shapes): n simulations, A agents of each at most, f numbers of an observation.

An episode is a number of decisions at most; between two of them a world may simulate many steps.
What an episode is worth, its score, is the entry of a transfer matrix. Parameters are arguments and
never closed over, so one compiled program serves every context. They are a NamedTuple of arrays,
each of one context for all simulations, or with an axis of n; `stack_params` makes them, by name.

A family with one agent that is alone is written as an `Environment`, a few pure functions of one
simulation, and made a world by `Solo`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.engine.worlds import random
from mbtl.engine.worlds.environments import (
    Box,
    Described,
    Discrete,
    Environment,
    Length,
    TimeLimit,
    Tree,
)
from mbtl.errors import InvalidInput

_FIRST, _ANY = 1 << 23, 1 << 20  # streams of random numbers: first states, actions of no policy
_ANY_KEY = 1


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


class World(Described, Protocol):
    """Dynamics of n simulations; hashable, as it is a compile-time constant.

    Attributes:
        agents: A.
        drives: whether it goes on without any advice, see `drive`.

    A world may know rules by which its agents may act, what a training can begin with (`begin` of a
    recipe): `rule(name)` gives layers (weight (n_in, n_out), bias (n_out,)) of a network of tanh,
    for observations without visible context.
    """

    @property
    def agents(self) -> int: ...  # noqa: D102
    @property
    def drives(self) -> bool: ...  # noqa: D102

    def decisions(self, params: Tree) -> Length:
        """Length of an episode at most, in this context or in these; not traced."""
        ...

    def draws(self, seeds: NDArray[np.uint32]) -> NDArray[Any]:
        """What `start` takes for the episodes of `seeds`, (...) -> (..., ?); not traced."""
        ...

    def start(self, drawn: jax.Array, params: Tree) -> Tree:
        """States at the first decision, from what `draws` gave for n seeds, or from the seeds."""
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

    def any_actions(self, seeds: jax.Array, moment: jax.Array) -> jax.Array:
        """What `step` takes, any as likely as another, from (n,) seeds and the moment."""
        ...

    def over(self, state: Tree) -> jax.Array:
        """(n,) nothing that happens from now on counts."""
        ...

    def score(self, state: Tree) -> jax.Array:
        """(n,) matrix entry of episodes that have ended; larger is better."""
        ...


@runtime_checkable
class Crowd(World, Protocol):
    """A world of many agents that can show some of them: only those who act are looked at."""

    def acting(self, state: Tree) -> jax.Array:
        """(n, A) there is an agent, and it decides."""
        ...

    def views(
        self, state: Tree, params: Tree, simulation: jax.Array, place: jax.Array
    ) -> jax.Array:
        """(..., f) observations of the agents in some places, (...), of some simulations, (...)."""
        ...


def everyone(world: Crowd, state: Tree, params: Tree) -> Seen:
    """What `World.observe` gives, in terms of `Crowd.views`."""
    acting = world.acting(state)
    simulation, place = jnp.indices(acting.shape)
    return Seen(world.views(state, params, simulation, place), acting)


class Seeded:
    """Defaults of worlds that draw all they need from the seed of an episode, (n,) uint32."""

    action: Discrete | Box
    agents: int
    drives: bool = True
    max_return: float | None = None

    def draws(self, seeds: NDArray[np.uint32]) -> NDArray[Any]:
        """The seeds themselves."""
        return seeds

    def any_actions(self, seeds: jax.Array, moment: jax.Array) -> jax.Array:
        """Uniform ones."""
        one, moment = (seeds, _ANY), jnp.uint32(moment)
        if isinstance(self.action, Discrete):
            draw = random.uniform(*one, moment, self.agents).T
            return jnp.floor(draw * self.action.n).astype(jnp.int32)
        low, high = jnp.asarray(self.action.low), jnp.asarray(self.action.high)
        draw = random.uniform(*one, moment, self.agents * len(low)).T
        return low + (high - low) * draw.reshape(-1, self.agents, len(low))

    def over(self, state: Any) -> jax.Array:
        """Never before time is up."""
        return jnp.array([False])


class Played(NamedTuple):
    """n simulations of one agent.

    Attributes:
        env: their states.
        alive: (n,) no terminal state has been reached.
        total: (n,) sum of the rewards until then.
        steps: (n,) how many there were.
    """

    env: Tree
    alive: jax.Array
    total: jax.Array
    steps: jax.Array


@dataclass(frozen=True, repr=False)
class Solo:
    """n simulations of an `Environment`, each with one agent, whose score is the sum of rewards.

    Evaluated episodes begin with the random numbers that the Gymnasium environment would draw from
    their seed: returns can be compared across engines episode by episode, up to float32's rounding.

    Attributes:
        env: one simulation.
    """

    env: Environment
    agents: int = 1

    def __post_init__(self) -> None:
        """Refuse an action that is none, and is no action.

        Raises:
            InvalidInput: `idle` has another shape than an action.
        """
        if not self.drives:
            return
        action, idle = self.env.action, np.asarray(self.env.idle)  # type: ignore[attr-defined]
        shape = () if isinstance(action, Discrete) else (len(action.low),)
        whole = isinstance(action, Box) or idle.dtype.kind in "iu"
        if idle.shape != shape or not whole:
            one = f"{len(action.low)} numbers" if isinstance(action, Box) else "a whole number"
            raise InvalidInput(
                f"idle of {type(self.env).__name__} is an action, {one}, got {idle.tolist()}"
            )

    def __repr__(self) -> str:
        return repr(self.env)

    @property
    def time_limit(self) -> TimeLimit:
        """Of the environment."""
        return self.env.time_limit

    @property
    def action(self) -> Discrete | Box:
        """Of the environment."""
        return self.env.action

    @property
    def n_features(self) -> int:
        """Of the environment."""
        return self.env.n_features

    @property
    def max_return(self) -> float | None:
        """Of the environment."""
        return self.env.max_return

    @property
    def params(self) -> type[Any]:
        """Of the environment."""
        return self.env.params

    @property
    def drives(self) -> bool:
        """Whether the environment has an action that is none, `idle`."""
        return hasattr(self.env, "idle")

    def decisions(self, params: Tree) -> int:
        """The same in every context."""
        return self.env.horizon

    def draws(self, seeds: NDArray[np.uint32]) -> NDArray[Any]:
        """(..., n_noise) uniform numbers, as `reset(seed=...)` of Gymnasium draws them."""
        seeds = np.asarray(seeds)
        rows = [np.random.default_rng(int(s)).random(self.env.n_noise) for s in seeds.reshape(-1)]
        return np.array(rows, np.float32).reshape(*seeds.shape, self.env.n_noise)

    def noise(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        """What starts copies of this shape, from a key: (..., n_noise)."""
        return jax.random.uniform(key, (*shape, self.env.n_noise))

    def start(self, drawn: jax.Array, params: Tree) -> Played:
        """First states from (n, n_noise) uniform numbers, or from (n,) seeds."""
        if drawn.ndim == 1:
            drawn = random.uniform(drawn, _FIRST, jnp.uint32(0), self.env.n_noise).T
        state = jax.vmap(self.env.initial, (0, _axis(params)))(drawn, params)
        n = len(drawn)
        return Played(state, jnp.ones(n, bool), jnp.zeros(n), jnp.zeros(n, jnp.int32))

    def restart(self, state: Played, over: jax.Array, noise: jax.Array, params: Tree) -> Played:
        """The states, but first ones where a simulation is over, (n,)."""

        def anew(fresh: jax.Array, old: jax.Array) -> jax.Array:
            return jnp.where(over.reshape(-1, *[1] * (old.ndim - 1)), fresh, old)

        played: Played = jax.tree.map(anew, self.start(noise, params), state)
        return played

    def observe(self, state: Played, params: Tree) -> Seen:
        """Of the one agent, while it is alive."""
        obs = jax.vmap(self.env.observe, (0, _axis(params)))(state.env, params)
        return Seen(obs[:, None], state.alive[:, None])

    def step(self, state: Played, action: jax.Array, params: Tree) -> Moved:
        """One step; what comes after a terminal state does not count."""
        step = jax.vmap(self.env.step, (0, 0, _axis(params)))
        new, reward, terminated = step(state.env, action[:, 0], params)
        reward = jnp.where(state.alive, reward, 0.0).astype(jnp.float32)
        total, steps = state.total + reward, state.steps + state.alive
        played = Played(new, state.alive & ~terminated, total, steps)
        return Moved(played, reward[:, None], (state.alive & terminated)[:, None])

    def drive(self, state: Played, params: Tree) -> Moved:
        """One step with the action `idle`."""
        idle = jnp.asarray(self.env.idle)  # type: ignore[attr-defined]  # `drives` says so
        return self.step(state, jnp.broadcast_to(idle, (len(state.alive), 1, *idle.shape)), params)

    def any_actions(self, seeds: jax.Array, moment: jax.Array) -> jax.Array:
        """Uniform ones."""

        def one(seed: jax.Array) -> jax.Array:
            key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), _ANY_KEY), moment)
            if isinstance(self.action, Discrete):
                return jax.random.randint(key, (), 0, self.action.n)
            low, high = jnp.asarray(self.action.low), jnp.asarray(self.action.high)
            return jax.random.uniform(key, low.shape, minval=low, maxval=high)

        return jax.vmap(one)(seeds)[:, None]

    def over(self, state: Played) -> jax.Array:
        """A terminal state has been reached."""
        return ~state.alive

    def score(self, state: Played) -> jax.Array:
        """Sum of the rewards."""
        return state.total


def _axis(params: Tree) -> int | None:
    """Of `jax.vmap`: parameters of every simulation, or of one context for all."""
    return 0 if params.visible.ndim == 2 else None


def stack_params(
    world: World | Environment, constants: Sequence[Any], visible: ArrayLike | None = None
) -> Any:
    """Parameters of many contexts, one leading axis, matched by name.

    Args:
        world: for which they are.
        constants: per context the values of all fields of `world.params` but `visible`: a mapping,
            or a NamedTuple such as the Gymnasium module's `derive` gives.
        visible: (contexts, v) features appended to observations; None for none.

    Returns:
        `world.params` of numpy arrays in float64 (jax rounds them when x64 is off): (contexts,) per
        constant, (contexts, v) visible.

    Raises:
        InvalidInput: the constants are not those of this world.
    """
    names = world.params._fields[:-1]
    rows = [c if isinstance(c, Mapping) else getattr(c, "_asdict", dict)() for c in constants]
    for row in rows:
        if set(row) != set(names):
            raise InvalidInput(
                f"constants must be named {', '.join(names)}, got {', '.join(row) or 'no names'}; "
                "pass what `derive` returns for each context"
            )
    shown: NDArray[np.float64] = (
        np.zeros((len(rows), 0)) if visible is None else np.asarray(visible, dtype=np.float64)
    )
    if shown.ndim != 2 or len(shown) != len(rows):
        raise InvalidInput(
            f"visible features must be ({len(rows)}, v), one row per context, got {shown.shape}"
        )
    table = {name: np.array([row[name] for row in rows], dtype=np.float64) for name in names}
    return world.params(**table, visible=shown)


def context_of(params: Tree, index: int) -> Any:
    """Parameters of one of many contexts."""
    return jax.tree.map(lambda x: x[index], params)


def of_simulations(params: Tree, episodes: int) -> Any:
    """Parameters of every simulation of P policies, policy by policy, (P x episodes, ...).

    Args:
        params: of one context, which serve all; (P, ...): each policy's own context; (P, N, ...):
            N contexts of each policy, each for as many of its episodes, the first come first.
        episodes: of each policy.
    """
    if params.visible.ndim == 1:
        return params
    each = episodes // params.visible.shape[1] if params.visible.ndim == 3 else episodes
    params = in_a_row(params)
    return jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x), each, axis=0), params)


def in_a_row(params: Tree) -> Any:
    """Parameters with one leading axis, (P x N, ...), where they have two, (P, N, ...)."""
    if params.visible.ndim < 3:
        return params
    rows = math.prod(params.visible.shape[:2])  # where nothing is visible, it cannot be inferred
    return jax.tree.map(lambda x: x.reshape(rows, *np.shape(x)[2:]), params)
