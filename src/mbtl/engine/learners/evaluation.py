"""Whole episodes of many policies on many contexts, scored, with the same luck for all policies.

Notation (shapes): P policies, C contexts, E episodes; n simulations, policy by policy.

Each context has episodes of its own, the same for every policy. What is drawn in one follows from
its seed and the moment: it is the same in any company.

A world may know that luck is of K kinds. Then an episode is one of each, and worth their mean:
`strata(params)` of the world gives the parameters of C contexts with each kind, context by context,
(C x K, ...), and how probable the kinds are, (C, K).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.arrays import Array
from mbtl.engine.learners.episodic.episodes import Acting, Actor, measures
from mbtl.engine.learners.recipes import Activation
from mbtl.engine.worlds.environments import Tree
from mbtl.engine.worlds.world import Solo, World, context_of, in_a_row, of_simulations
from mbtl.errors import InvalidInput
from mbtl.score import RANDOM_ACTIONS

CPU_ROWS = 400
"""Simulations of one small agent played together on a CPU: their activations stay in its cache."""

_SHARE, _LANES = 3, 16

DEVICE_ROWS = 1 << 20
"""The same on an accelerator: 256 MB for each layer of 64 units."""

DEVICE_CROWDS = 1 << 17
"""Simulations of a world other than `Solo` that an accelerator plays together."""


def on_cpu() -> bool:
    """Whether jax computes on the CPU of this machine."""
    return bool(jax.default_backend() == "cpu")


def own_measures(
    world: World,
    activation: Activation,
    how: Acting,
    actor: Actor,
    seeds: NDArray[np.uint32],
    params: Tree,
) -> dict[str, jax.Array]:
    """(P, E) of each policy on its own context, or on N of them in equal parts, by name.

    What the world measures of an episode, its "score" among it. Parameters are of one context,
    which serves all; (P, ...); or (P, N, ...). Of the (P, E) seeds the first are for the first
    context.
    """
    drawn, actor = world.draws(seeds), actor._replace(critic=())
    every = of_simulations(params, seeds.shape[1])
    decisions = world.decisions(in_a_row(params))
    played = measures(world, activation, how, actor, seeds, drawn, every, decisions)
    return cast(dict[str, jax.Array], played)


def evaluate(
    world: World,
    actor: Actor,
    params: Tree,
    seeds: ArrayLike,
    *,
    activation: Activation = "tanh",
    how: Acting = "mean",
) -> Array:
    """(P, C, E) scores of every policy on every context, in raw units; see `measured`."""
    return measured(world, actor, params, seeds, activation=activation, how=how)["score"]


def measured(
    world: World,
    actor: Actor | None,
    params: Tree,
    seeds: ArrayLike,
    *,
    activation: Activation = "tanh",
    how: Acting = "mean",
    way: str = "",
) -> dict[str, Array]:
    """All that the world measures of an episode, by name; its "score" among it.

    Args:
        world: the dynamics.
        actor: of P policies, leading axis; None: what goes without one, P = 1.
        params: of C contexts, likewise.
        seeds: (C, E) of the episodes in each context.
        activation: between the layers of the actors.
        how: actions follow from a policy.
        way: without one: "random_actions", "unguided", or one of the world's `ways`.

    Returns:
        (P, C, E) each.

    Raises:
        InvalidInput: there are no policies, contexts or episodes, or seeds of another shape.
    """
    if actor is None:
        actor, how = Actor((), jnp.zeros((1, 1))), "random" if way == RANDOM_ACTIONS else "none"
        world = replace(cast(Any, world), way=way) if way in getattr(world, "ways", ()) else world
    n_policies, n_contexts = len(actor.log_std), len(params.visible)
    own = np.array(seeds, np.uint32)
    if own.ndim != 2 or len(own) != n_contexts or 0 in (n_policies, *own.shape):
        raise InvalidInput(
            "evaluation takes one policy or more, and for each of one or more contexts the seeds "
            f"of its episodes, got {n_policies} and {n_contexts} with seeds of shape {own.shape}"
        )
    n_episodes = own.shape[1]
    most = getattr(world, "most", None)  # simulations at once
    if most is not None and n_episodes > most:
        each = partial(measured, world, actor, params, activation=activation, how=how)
        some = [each(own[:, first : first + most]) for first in range(0, n_episodes, most)]
        return {name: np.concatenate([one[name] for one in some], axis=-1) for name in some[0]}
    shares = np.ones((n_contexts, 1))
    if hasattr(world, "strata"):
        params, shares = world.strata(params)
    own, actor = np.repeat(own, shares.shape[1], axis=0), actor._replace(critic=())
    shape = n_policies, shares.size * n_episodes
    episodes = _Episodes(world, activation, how, actor, own, params)
    if isinstance(world, Solo):
        parts = _blocks(episodes)
    elif most or on_cpu():
        height = n_policies if most is None else min(n_policies, most // n_episodes)
        parts = _context_by_context(episodes, height)
    else:
        parts, shape = _pairs(episodes), (-1, n_episodes)
    found: dict[str, Array] = {}
    for p, first, part in parts:
        for name, numbers in part.items():
            if name not in found:
                found[name] = np.empty((n_policies, shares.size, n_episodes))
            place = found[name].reshape(shape)[p:, first:]
            there = np.asarray(numbers)[: len(place), : place.shape[1]]
            place[: len(there), : there.shape[1]] = there
    kinds = (n_policies, *shares.shape, n_episodes)
    return {
        name: np.einsum("pcke,ck->pce", numbers.reshape(kinds), shares)
        for name, numbers in found.items()
    }


class _Episodes(NamedTuple):
    """What is played: by P policies in C contexts, with (C, E) seeds."""

    world: World
    activation: Activation
    how: Acting
    actor: Actor
    seeds: NDArray[np.uint32]
    params: Tree


Part = tuple[int, int, dict[str, jax.Array]]
"""First row and column of a table, and what is measured from there on; beyond its end nonsense."""


def _blocks(episodes: _Episodes) -> Iterator[Part]:
    """Of (P, C x E) episodes, so many of all contexts at a time.

    A block has a third of the episodes that it may have, so that few wait for the longest; a
    multiple of what a processor computes at once, so that no place in it is computed otherwise.
    """
    world, activation, how, actor, seeds, params = episodes
    drawn, count, n_episodes = world.draws(seeds), seeds.size, seeds.shape[1]
    drawn, seeds = drawn.reshape(count, *drawn.shape[2:]), seeds.reshape(count)
    rows = CPU_ROWS if on_cpu() else DEVICE_ROWS
    most = min(count, rows)
    width = min(most, -(-most // (_SHARE * _LANES)) * _LANES)
    height, decisions = min(len(actor.log_std), rows // most), world.decisions(params)
    for p in range(0, len(actor.log_std), height):
        some = _take(actor, p, height, len(actor.log_std))
        for first in range(0, count, width):
            own = np.minimum(np.arange(first, first + width), count - 1)
            own = np.tile(own, (height, 1))
            where = taken(params, own.ravel() // n_episodes)
            played = (seeds[own], drawn[own], where, decisions)
            yield p, first, measures(world, activation, how, some, *played)


def _context_by_context(episodes: _Episodes, height: int) -> Iterator[Part]:
    """The same, so many policies at a time: all of a batch may decide something together."""
    world, activation, how, actor, seeds, params = episodes
    n_policies, n_episodes = len(actor.log_std), seeds.shape[1]
    for p in range(0, n_policies, height):
        some = _take(actor, p, height, n_policies)
        for c, own in enumerate(seeds):
            everyone, where = np.tile(own, (height, 1)), context_of(params, c)
            part = own_measures(world, activation, how, some, everyone, where)
            yield p, c * n_episodes, part


def _pairs(episodes: _Episodes) -> Iterator[Part]:
    """Of (P x C, E) episodes, many pairs of a policy and a context together."""
    world, activation, how, actor, seeds, params = episodes
    who, where = np.indices((len(actor.log_std), len(seeds))).reshape(2, -1)
    step = min(len(who), max(1, DEVICE_CROWDS // seeds.shape[1]))
    for first in range(0, len(who), step):
        own, at = _take((who, where), first, step, len(who))
        some, there = taken(actor, own), taken(params, at)
        yield first, 0, own_measures(world, activation, how, some, seeds[at], there)


def taken(tree: Tree, which: Any) -> Any:
    """Members of the leading axis."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[which], tree)


def joined(trees: Sequence[Tree]) -> Any:
    """One tree, along the leading axis."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *trees)


def _take(tree: Tree, first: int, count: int, size: int) -> Any:
    """Members first..first+count-1; the last one repeats, so that there is one shape to compile."""
    return taken(tree, np.minimum(np.arange(first, first + count), size - 1))
