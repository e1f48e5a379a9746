"""Whole episodes of a twin: recorded to learn from, or only scored; networks see who acts alone.

Notation (shapes): P policies, E episodes each, D decisions, A agents; simulations are ordered
policy by policy, n = P x E. All play in one context.

Random actions too are functions of the episode's seed, which makes it independent of its company.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.engine.learners import networks
from mbtl.engine.learners.networks import Network
from mbtl.engine.learners.recipes import Activation
from mbtl.engine.worlds import beats, random
from mbtl.engine.worlds.environments import Beats, Discrete, Length, Tree
from mbtl.engine.worlds.packing import Agents, chunk_size, most_rows
from mbtl.engine.worlds.world import Crowd, Solo, World
from mbtl.portfolio import BoxHead, MLPPolicy

Acting = Literal["sampled", "mean", "random", "none"]
"""How actions follow from a policy: drawn, the most likely one, or not: any, or no advice."""

_ACTION = 1 << 20  # stream of random numbers, apart from those of the twins


class Actor(NamedTuple):
    """The acting part of P policies, leading axis, and the critic; () where there is none."""

    network: Network
    log_std: jax.Array
    critic: Network = ()


def actor_of(weights: Any) -> Actor:
    """What P policies have learnt, as it plays and watches."""
    return Actor(weights.actor, weights.log_std, weights.critic)


def import_actor(policies: list[MLPPolicy]) -> Actor:
    """The acting part of policies of one shape."""
    layers = zip(*[zip(p.weights, p.biases, strict=True) for p in policies], strict=True)
    network = tuple(
        (np.stack([w.T for w, _ in each]), np.stack([b for _, b in each])) for each in layers
    )
    stds = [p.head.log_std if isinstance(p.head, BoxHead) else np.zeros(0) for p in policies]
    log_std = np.asarray(np.stack(stds), np.float32)  # type: ignore[arg-type]
    return cast(Actor, jax.device_put(Actor(network, log_std)))


class Rows(NamedTuple):
    """Observations so far, (P, rows, f), and how many of the rows are used."""

    obs: jax.Array
    used: jax.Array


class Watched(NamedTuple):
    """A moment: who acts, (P, E, A), what networks say of it, (P, E, A, m) each; a crowd's rows."""

    acting: jax.Array
    found: tuple[jax.Array, ...]
    row: jax.Array | None = None


class Episodes(NamedTuple):
    """What was lived through; leading axes (P, D, E, A) unless said otherwise.

    Attributes:
        obs: (P, rows, f) of agents that decided, one after the other; then nonsense.
        row: of `obs`; any where nobody decided.
        outputs: (..., m) of the actor that played.
        action: integers, or (..., d).
        value: of the critic that watched.
        acting: there was an agent that decided.
        reward: until the next decision.
        done: the life of the agent ended then.
        last_value: (P, E, A) after the last decision.
        last_acting: (P, E, A) whose life goes on then; nobody's at a time limit that is terminal.
        score: (P, E).
    """

    obs: jax.Array
    row: jax.Array
    outputs: jax.Array
    action: jax.Array
    value: jax.Array
    acting: jax.Array
    reward: jax.Array
    done: jax.Array
    last_value: jax.Array
    last_acting: jax.Array
    score: jax.Array


def record(
    twin: World,
    activation: Activation,
    decisions: Length,
    actor: Actor,
    seeds: jax.Array,
    params: Tree,
    hold: int = 1,
    chosen: Callable[[jax.Array], jax.Array] = lambda outputs: outputs,
) -> Episodes:
    """Play the episodes of (P, E) seeds with sampled actions and keep everything.

    Parameters are of one context, or of every simulation. For `hold` decisions what is random in an
    action stays the same. `chosen` makes of the actor's outputs what is sampled. Without a critic
    values are 0. Static: the dynamics, the activation, how long episodes are, and `hold`.
    """
    shape, flat = seeds.shape, seeds.reshape(-1)

    def split(x: jax.Array) -> jax.Array:  # (n, ...) -> (P, E, ...)
        return x.reshape(*shape, *x.shape[1:])

    def by_policy(x: jax.Array) -> jax.Array:  # (D, n, ...) -> (P, D, E, ...)
        return jnp.moveaxis(x.reshape(len(x), *shape, *x.shape[2:]), 0, 1)

    def told(outputs: jax.Array, number: jax.Array) -> tuple[jax.Array, jax.Array]:
        action = _sampled(twin, actor, chosen(outputs), flat, number // hold)
        joint = action.reshape(-1, *action.shape[2:])
        return networks.to_environment(joint, twin.action), joint

    def decide(state: Tree, number: jax.Array) -> tuple[jax.Array, Tree]:
        obs, acting = twin.observe(state, params)
        outputs = each(activation, actor.network, split(obs))
        applied, action = told(outputs, number)
        return applied, (obs, acting, outputs.reshape(-1, *outputs.shape[2:]), action)

    def decide_packed(carry: tuple[Tree, Rows], number: jax.Array) -> tuple[Any, Tree]:
        state, rows = carry
        seen, rows = watch((actor.network, critic), state, rows)
        applied, action = told(seen.found[0], number)
        moved = twin.step(state, applied, params)
        kept = (seen.row, seen.acting, *seen.found)
        return (moved.state, rows), (*kept, *map(split, (action, moved.reward, moved.done)))

    state = twin.start(flat, params)
    watch = partial(watched, twin, activation, params, shape)
    n_inputs = actor.network[0][0].shape[1]  # without a critic everything is worth 0
    worthless = ((jnp.zeros((shape[0], n_inputs, 1)), jnp.zeros((shape[0], 1))),)
    critic = actor.critic or worthless
    if isinstance(twin, Crowd):
        assert not isinstance(decisions, Beats)
        places = shape[1] * twin.agents
        n_features = twin.n_features + params.visible.shape[-1]
        room = jnp.zeros((shape[0], decisions * most_rows(places), n_features))
        carry = (state, Rows(room, jnp.int32(0)))
        moments = jnp.arange(decisions, dtype=jnp.uint32)
        (state, rows), kept = jax.lax.scan(decide_packed, carry, moments)
        row, acting, outputs, value, action, reward, done = (jnp.moveaxis(x, 0, 1) for x in kept)
        obs = rows.obs
    else:
        state, found = beats.lived(twin, decisions, state, params, decide)
        obs, acting, outputs, action = map(by_policy, found.kept)
        reward, done = by_policy(found.reward), by_policy(found.done)
        value = each(activation, critic, obs)
        row = jnp.broadcast_to(jnp.arange(acting[0].size).reshape(acting.shape[1:]), acting.shape)
        acting &= by_policy(found.due)[..., None]
        obs = obs.reshape(len(obs), -1, obs.shape[-1])
    last, _ = watch((critic,), state)
    return Episodes(
        obs=obs,
        row=row,
        outputs=outputs,
        action=action,
        value=value[..., 0],
        acting=acting,
        reward=reward,
        done=done,
        last_value=last.found[0][..., 0],
        last_acting=last.acting & (twin.time_limit == "truncation"),
        score=split(twin.score(state)),
    )


@partial(jax.jit, static_argnums=(0, 1, 2))
def measures(
    twin: World,
    activation: Activation,
    how: Acting,
    actor: Actor,
    seeds: jax.Array,
    drawn: jax.Array,
    params: Tree,
    decisions: Tree,
) -> dict[str, jax.Array]:
    """(P, E) scores, "score", and what else the world measures of an episode, by name.

    Arguments as in `record`, `drawn` is `World.draws` of the seeds. One compiled program serves all
    contexts, one after the other or, in beats, together; it ends as soon as all episodes have. The
    numbers of `decisions` need not be static.
    """
    shape, flat = seeds.shape, seeds.reshape(-1)

    def told(state: Tree, moment: jax.Array) -> jax.Array | None:
        if how == "none":
            return None
        if how == "random":
            return twin.any_actions(flat, moment)
        played = (actor.network,)
        (outputs,) = watched(twin, activation, params, shape, played, state)[0].found
        if how == "sampled":
            action = _sampled(twin, actor, outputs, flat, moment)
            action = networks.to_environment(action, twin.action)
        else:
            action = networks.mode(outputs, twin.action)
        return action.reshape(-1, *action.shape[2:])

    state = twin.start(drawn.reshape(-1, *drawn.shape[2:]), params)
    end = beats.played(twin, decisions, state, params, told)
    found = twin.measures(end) if hasattr(twin, "measures") else {"score": twin.score(end)}
    if isinstance(twin, Solo):
        found["steps"] = end.steps
    return {name: each.reshape(shape) for name, each in found.items()}


def _sampled(
    twin: World, actor: Actor, outputs: jax.Array, seeds: jax.Array, moment: jax.Array
) -> jax.Array:
    """(P, E, A) or (P, E, A, d) actions, not clipped."""
    if isinstance(twin.action, Discrete):
        d, draw = (), random.uniform(seeds, _ACTION, moment, twin.agents)
    else:
        d = actor.log_std.shape[-1:]
        draw = random.normal(seeds, _ACTION, moment, twin.agents * d[0])
    noise = draw.T.reshape(*outputs.shape[:2], twin.agents, *d)
    one = partial(networks.sample, action=twin.action)
    return cast(jax.Array, jax.vmap(one)(outputs, actor.log_std, noise))


def watched(
    twin: World,
    activation: Activation,
    params: Tree,
    shape: tuple[int, ...],
    played: tuple[Network, ...],
    state: Tree,
    rows: Rows | None = None,
) -> tuple[Watched, Any]:
    """Networks of P policies, `shape` (P, E), applied to what their agents see; 0 where none is.

    `rows` is where to keep the observations of a crowd; None to keep none.
    """
    if not isinstance(twin, Crowd):
        obs, acting = twin.observe(state, params)
        acting = acting.reshape(*shape, -1)
        obs = obs.reshape(*acting.shape, -1)
        return Watched(acting, tuple(each(activation, network, obs) for network in played)), rows
    used = jnp.int32(0) if rows is None else rows.used
    acting = twin.acting(state).reshape(*shape, -1)
    agents = Agents.of(acting)
    size = chunk_size(acting[0].size)

    def chunk(carry: tuple[jax.Array, Any, Any]) -> tuple[jax.Array, Any, Any]:
        start, found, rows = carry
        obs = twin.views(state, params, *agents.chunk(start, size))
        new = (each(activation, network, obs) for network in played)
        found = tuple(agents.spread(x, start, into) for x, into in zip(new, found, strict=True))
        if rows is not None:
            at = (0, used + start, 0)
            rows = rows._replace(obs=jax.lax.dynamic_update_slice(rows.obs, obs, at))
        return start + size, found, rows

    def more(carry: tuple[jax.Array, Any, Any]) -> jax.Array:
        return carry[0] < agents.most

    nothing = tuple(jnp.zeros((*acting.shape, network[-1][1].shape[-1])) for network in played)
    end, found, rows = jax.lax.while_loop(more, chunk, (jnp.int32(0), nothing, rows))
    if rows is not None:
        rows = rows._replace(used=used + end)
    return Watched(acting, found, used + agents.number), rows


def each(activation: Activation, network: Network, obs: jax.Array) -> jax.Array:
    """(P, ..., f) -> (P, ..., m), each policy its own."""
    one = partial(networks.apply, activation=activation)
    return cast(jax.Array, jax.vmap(one)(network, obs))
