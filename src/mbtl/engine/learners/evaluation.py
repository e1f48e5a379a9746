"""Whole episodes of many policies on many contexts, scored, with the same luck for all policies.

Notation (shapes): P policies, C contexts, E episodes; n simulations, policy by policy.

Each context has episodes of its own, the same for every policy. What is drawn in one follows from
its seed and the moment: it is the same in any company.

A world may know that luck is of K kinds. Then an episode is one of each, and worth their mean:
`strata(params)` of the world gives the parameters of C contexts with each kind, context by context,
(C x K, ...), and how probable the kinds are, (C, K).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.arrays import Array
from mbtl.engine.learners.episodic.episodes import Acting, Actor, go_on, measures
from mbtl.engine.learners.recipes import Activation
from mbtl.engine.worlds import ends
from mbtl.engine.worlds.environments import Tree
from mbtl.engine.worlds.world import Solo, World, context_of, in_a_row, of_simulations
from mbtl.errors import InvalidInput

CPU_ROWS = 400
"""Simulations of one small agent played together on a CPU: their activations stay in its cache."""

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
    found: dict[str, jax.Array] = measures(
        world, activation, how, actor, seeds, drawn, every, decisions
    )
    return found


def evaluate(
    world: World,
    actor: Actor,
    params: Tree,
    seeds: ArrayLike,
    *,
    activation: Activation = "tanh",
    how: Acting = "mean",
    rows: int | None = None,
) -> Array:
    """Scores of every policy on every context, in raw units.

    Args:
        world: the dynamics.
        actor: of P policies, leading axis.
        params: of C contexts, likewise.
        seeds: (C, E) of the episodes in each context.
        activation: between the layers of the actors.
        how: actions follow from a policy.
        rows: simulations at a time; None chooses for world and device.

    Returns:
        (P, C, E).

    Raises:
        InvalidInput: there are no policies, contexts or episodes, or seeds of another shape.
    """
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
        parts = [own[:, first : first + most] for first in range(0, n_episodes, most)]
        each = partial(evaluate, world, actor, params, activation=activation, how=how)
        return np.concatenate([each(some) for some in parts], axis=-1)
    params, shares = of_each_kind(world, params)
    own, n_contexts = np.repeat(own, shares.shape[1], axis=0), shares.size
    solo = isinstance(world, Solo)  # else all simulations of a batch may decide something together
    if not (solo or most or on_cpu()):
        found = _pairs(world, activation, how, actor, own, params)
        return merged(found.reshape(n_policies, n_contexts, n_episodes), shares)
    fitting = CPU_ROWS if solo else n_policies * n_episodes
    rows = rows or most or (fitting if on_cpu() else DEVICE_ROWS)
    width = min(n_episodes * (n_contexts if solo else 1), rows)  # of a policy
    height = max(1, min(n_policies, rows // width))
    drawn, actor = world.draws(own) if solo else own, actor._replace(critic=())
    returns = np.empty((n_policies, n_contexts, n_episodes))
    for p in range(0, n_policies, height):
        some, place = _take(actor, p, height, n_policies), returns[p : p + height]
        count = len(place)
        if isinstance(world, Solo):

            def play(state: Tree, own: Any, where: Tree, *when: int, some: Actor = some) -> Tree:
                return go_on(world, activation, how, some, own, where, state, *when)

            found = ends.scores(world, params, own, drawn, height, width, play)
            place[...] = found.reshape(height, *place.shape[1:])[:count]
            continue
        for c in range(n_contexts):  # one at a time, as simulations cannot be told apart
            where = context_of(params, c)
            everyone = np.tile(own[c], (height, 1))
            part = own_measures(world, activation, how, some, everyone, where)["score"]
            place[:, c] = np.asarray(part)[:count]
    return merged(returns, shares)


def _pairs(
    world: World, activation: Activation, how: Acting, actor: Actor, seeds: Any, params: Tree
) -> Array:
    """(P x C, E) scores of every policy on every context, many of these pairs together."""
    who, where = np.indices((len(actor.log_std), len(seeds))).reshape(2, -1)
    step, found = min(len(who), max(1, DEVICE_CROWDS // seeds.shape[1])), []
    for first in range(0, len(who), step):
        own, at = _take((who, where), first, step, len(who))
        some, there = taken(actor._replace(critic=()), own), taken(params, at)
        part = own_measures(world, activation, how, some, seeds[at], there)["score"]
        found.append(np.asarray(part)[: len(who) - first])
    return np.concatenate(found)


def of_each_kind(world: Any, params: Any) -> tuple[Any, Array]:
    """What a world says of kinds; the parameters and shares of 1 where it says nothing."""
    if hasattr(world, "strata"):
        every, shares = world.strata(params)
        return every, shares
    return params, np.ones((len(params.visible), 1))


def merged(scores: Array, shares: Array) -> Array:
    """(P, C, E) from (P, C x K, E): the mean of the kinds, weighted by how probable they are."""
    each = scores.reshape(len(scores), *shares.shape, scores.shape[-1])
    mean: Array = np.einsum("pcke,ck->pce", each, shares)
    return mean


def taken(tree: Tree, which: Any) -> Any:
    """Members of the leading axis."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[which], tree)


def joined(trees: Sequence[Tree]) -> Any:
    """One tree, along the leading axis."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *trees)


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
    """(C, E) of one policy on every context, by name: all that the world measures of an episode.

    Args:
        world: the dynamics; with `measures`.
        actor: of the policy; None: what goes by itself, by this `way` where the world has several.
        params: of C contexts.
        seeds: (C, E) of the episodes in each context.
        activation: between the layers of the actor.
        how: actions follow from the policy.
        way: one of the world's `ways`.
    """
    if actor is None:
        actor, how = Actor((), jnp.zeros((1, 1))), "none"
        world = replace(cast(Any, world), way=way) if way in getattr(world, "ways", ()) else world
    params, shares = of_each_kind(world, params)
    own = np.repeat(np.array(seeds, np.uint32), shares.shape[1], axis=0)
    each = [
        own_measures(world, activation, how, actor, own[c : c + 1], context_of(params, c))
        for c in range(shares.size)
    ]
    return {
        name: merged(np.stack([np.asarray(one[name]) for one in each], axis=1), shares)[0]
        for name in each[0]
    }


def reference_returns(world: World, params: Tree, seeds: ArrayLike, way: str) -> Array:
    """(C, E) scores without any policy, in the episodes of these (C, E) seeds.

    Args:
        world: the dynamics.
        params: of C contexts.
        seeds: of the episodes.
        way: "random_actions", "unguided", or one of the world's `ways`.
    """
    nobody, how = Actor((), jnp.zeros((1, 1))), "random" if way == "random_actions" else "none"
    if way not in ("random_actions", "unguided"):  # a controller of the world's own
        world = replace(cast(Any, world), way=way)
    found: Array = evaluate(world, nobody, params, seeds, how=cast(Acting, how))[0]
    return found


def _take(tree: Tree, first: int, count: int, size: int) -> Any:
    """Members first..first+count-1; the last one repeats, so that there is one shape to compile."""
    return taken(tree, np.minimum(np.arange(first, first + count), size - 1))
