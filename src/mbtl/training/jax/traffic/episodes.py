"""Whole episodes of a twin: recorded to learn from, or only scored.

Notation (shapes): P policies, E episodes each, D decisions, A agents; simulations are ordered
policy by policy, n = P x E. All play in one context.

Random actions too are functions of the episode's seed, which makes it independent of its company.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.portfolio import BoxHead, MLPPolicy
from mbtl.training.jax import networks
from mbtl.training.jax.environments import Discrete, Tree
from mbtl.training.jax.export import import_actors
from mbtl.training.jax.networks import Network
from mbtl.training.jax.recipes import Activation
from mbtl.training.jax.traffic import random
from mbtl.training.jax.traffic.twin import Moved, Seen, Twin

Acting = Literal["sampled", "mean", "random", "none"]
"""How actions follow from a policy: drawn, the most likely one, or not: any, or no advice."""

_ACTION = 1 << 20  # stream of random numbers, apart from those of the twins


class Actor(NamedTuple):
    """The acting part of P policies.

    Attributes:
        network: leading axis P.
        log_std: (P, d) of a Gaussian, (P, 0) for discrete actions.
    """

    network: Network
    log_std: jax.Array


def actor_of(weights: Any) -> Actor:
    """The acting part of what P policies have learnt."""
    return Actor(weights.actor, weights.log_std)


def import_actor(policies: list[MLPPolicy]) -> Actor:
    """The acting part of policies of one shape."""
    stds = [p.head.log_std if isinstance(p.head, BoxHead) else np.zeros(0) for p in policies]
    return Actor(import_actors(policies), jnp.asarray(np.stack(stds), jnp.float32))  # type: ignore[arg-type]


class Episodes(NamedTuple):
    """What was lived through; leading axes (P, D, E, A) unless said otherwise.

    Attributes:
        obs: (..., f).
        outputs: (..., m) of the actor that played.
        action: integers, or (..., d).
        acting: there was an agent that decided.
        reward: until the next decision.
        done: the life of the agent ended then.
        last_obs: (P, E, A, f) after the last decision.
        last_acting: (P, E, A) whose life goes on then; nobody's at a time limit that is terminal.
        score: (P, E).
    """

    obs: jax.Array
    outputs: jax.Array
    action: jax.Array
    acting: jax.Array
    reward: jax.Array
    done: jax.Array
    last_obs: jax.Array
    last_acting: jax.Array
    score: jax.Array


def record(
    twin: Twin,
    activation: Activation,
    decisions: int,
    actor: Actor,
    seeds: jax.Array,
    params: Tree,
    lasting: jax.Array | None = None,
) -> Episodes:
    """Play with sampled actions and keep everything.

    Args:
        twin: the dynamics; static.
        activation: between the layers of the actor; static.
        decisions: of an episode at most; static.
        actor: of P policies.
        seeds: (P, E) uint32, one per episode.
        params: of one context.
        lasting: decisions of an episode in this context, where one program serves several: before
            the first of them nobody acts. That is no delay of what comes later, and advantages run
            from the end of an episode to its beginning. None: as many as at most.
    """
    shape = seeds.shape
    flat = seeds.reshape(-1)

    def split(x: jax.Array) -> jax.Array:
        return x.reshape(*shape, *x.shape[1:])

    idle = jnp.uint32(0) if lasting is None else (decisions - lasting).astype(jnp.uint32)

    def step(state: Tree, seen: Seen, action: jax.Array) -> tuple[Moved, jax.Array]:
        applied = networks.to_environment(action, twin.action)
        return twin.step(state, applied.reshape(-1, *action.shape[2:]), params), seen.acting

    def wait(state: Tree, seen: Seen, action: jax.Array) -> tuple[Moved, jax.Array]:
        nobody = jnp.zeros_like(seen.acting)
        return Moved(state, nobody.astype(jnp.float32), nobody), nobody

    def one(state: Tree, moment: jax.Array) -> tuple[Tree, tuple[jax.Array, ...]]:
        seen = twin.observe(state, params)
        obs = split(seen.obs)
        outputs = _outputs(actor, obs, activation)
        action = _sampled(twin, actor, outputs, flat, moment - idle)
        if lasting is None:
            moved, acting = step(state, seen, action)
        else:
            moved, acting = jax.lax.cond(moment >= idle, step, wait, state, seen, action)
        row = (obs, outputs, action, *map(split, (acting, moved.reward, moved.done)))
        return moved.state, row

    moments = jnp.arange(decisions, dtype=jnp.uint32)
    state, by_moment = jax.lax.scan(one, twin.start(flat, params), moments)
    rows = [jnp.moveaxis(x, 0, 1) for x in by_moment]
    last = twin.observe(state, params)
    goes_on = last.acting & (twin.time_limit == "truncation")
    rows += [split(last.obs), split(goes_on), split(twin.score(state))]
    return Episodes(*rows)


@partial(jax.jit, static_argnums=(0, 1, 2))
def scores(
    twin: Twin,
    activation: Activation,
    how: Acting,
    actor: Actor,
    seeds: jax.Array,
    drawn: jax.Array,
    params: Tree,
    decisions: jax.Array,
) -> jax.Array:
    """(P, E) scores; arguments as in `record`, `drawn` is `World.draws` of the seeds.

    One compiled program serves all contexts; it ends as soon as all episodes have.
    """
    shape, flat = seeds.shape, seeds.reshape(-1)

    def going_on(carry: tuple[jax.Array, Tree]) -> jax.Array:
        return (carry[0] < decisions) & ~twin.over(carry[1]).all()

    def next_one(carry: tuple[jax.Array, Tree]) -> tuple[jax.Array, Tree]:
        return carry[0] + 1, one(*carry)

    def one(moment: jax.Array, state: Tree) -> Tree:
        if how == "none":
            return twin.drive(state, params).state
        if how == "random":
            action = twin.any_actions(flat, moment)
            return twin.step(state, action, params).state
        obs = twin.observe(state, params).obs
        outputs = _outputs(actor, obs.reshape(*shape, *obs.shape[1:]), activation)
        if how == "sampled":
            action = _sampled(twin, actor, outputs, flat, jnp.uint32(moment))
            action = networks.to_environment(action, twin.action)
        else:
            action = networks.mode(outputs, twin.action)
        return twin.step(state, action.reshape(-1, *action.shape[2:]), params).state

    first = twin.start(drawn.reshape(-1, *drawn.shape[2:]), params)
    _, state = jax.lax.while_loop(going_on, next_one, (jnp.int32(0), first))
    return twin.score(state).reshape(shape)


def _outputs(actor: Actor, obs: jax.Array, activation: Activation) -> jax.Array:
    """(P, E, A, f) -> (P, E, A, m)."""
    each = partial(networks.apply, activation=activation)
    outputs: jax.Array = jax.vmap(each)(actor.network, obs)
    return outputs


def _sampled(
    twin: Twin, actor: Actor, outputs: jax.Array, seeds: jax.Array, moment: jax.Array
) -> jax.Array:
    """(P, E, A) or (P, E, A, d) actions, not clipped."""
    policies, episodes = outputs.shape[:2]
    if isinstance(twin.action, Discrete):
        draw = random.uniform(seeds, _ACTION, moment, twin.agents)
        noise = draw.T.reshape(policies, episodes, twin.agents)
    else:
        d = actor.log_std.shape[-1]
        draw = random.normal(seeds, _ACTION, moment, twin.agents * d)
        noise = draw.T.reshape(policies, episodes, twin.agents, d)
    each = partial(networks.sample, action=twin.action)
    actions: jax.Array = jax.vmap(each)(outputs, actor.log_std, noise)
    return actions
