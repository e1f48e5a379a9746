"""Copies of a world that start again one by one: steps without end, for who learns on the way.

With N contexts copies take turns: one queue for all, and whenever an episode ends, its copy starts
the next context, 0, 1, ..., N - 1, 0, ...; of copies that end in the same step, the first goes
first. So at any time no context has been started more than once more often than another, however
long its episodes are and however many copies there are (cmdp-spec, 8.3).

Notation (shapes): E copies, o observation; the world has one agent.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mbtl.engine.worlds.environments import Tree
from mbtl.engine.worlds.world import Solo

Act = Callable[[jax.Array, Tree], tuple[jax.Array, Tree]]
"""(E, o) observations, what was drawn for them -> actions to apply, and what shall be kept."""


class Copies(NamedTuple):
    """E simulations of one policy: their states, and (E,) steps since each was started.

    Of N contexts: in which each is, (E,), and in which the next one starts; None where N = 1.
    """

    world: Tree
    elapsed: jax.Array
    context: jax.Array | None
    turn: jax.Array | None


class Step(NamedTuple):
    """What a step of E copies gave; `after` is the observation before a reset."""

    reward: jax.Array
    terminated: jax.Array
    done: jax.Array
    after: jax.Array


def first_copies(
    world: Solo, n_envs: int, seed: jax.Array, params: Tree
) -> tuple[Copies, jax.Array]:
    """Freshly started copies, and the key of what follows."""
    key, reset_key = jax.random.split(jax.random.PRNGKey(seed))
    noise = world.noise(reset_key, (n_envs,))
    context = turn = None
    if params.visible.ndim == 2:
        n_contexts = params.visible.shape[0]
        context, turn = jnp.arange(n_envs) % n_contexts, jnp.int32(n_envs % n_contexts)
    states = world.start(noise, _own(params, context))
    return Copies(states, jnp.zeros(n_envs, dtype=jnp.int32), context, turn), key


def stepped(
    world: Solo, params: Tree, copies: Copies, act: Act, drawn: Tree, resets: jax.Array
) -> tuple[Copies, jax.Array, Tree, Step]:
    """T steps of the copies: where they are then, what was seen and kept in each, what it gave.

    Args:
        world: the dynamics.
        params: of one context, or of N.
        copies: where they are.
        act: how they act.
        drawn: what `act` gets in each step, leading axis T.
        resets: (T, E, n_noise), for first states.
    """

    def one(carry: tuple[Copies, jax.Array], now: tuple[Tree, jax.Array]) -> Any:
        copies, obs = carry
        applied, kept = act(obs, now[0])
        copies, step = _advance(world, params, copies, applied, now[1])
        return (copies, _look(world, params, copies)), (obs, kept, step)

    first = (copies, _look(world, params, copies))
    (copies, _), (obs, kept, step) = jax.lax.scan(one, first, (drawn, resets))
    return copies, obs, kept, step


def _advance(
    world: Solo, params: Tree, copies: Copies, action: jax.Array, noise: jax.Array
) -> tuple[Copies, Step]:
    """One step of the E copies; one that has ended starts anew from its noise."""
    own = _own(params, copies.context)
    moved = world.step(copies.world, action[:, None], own)
    terminated = moved.done[:, 0]
    done = terminated | (copies.elapsed + 1 >= world.decisions(params))
    after = world.observe(moved.state, own).obs[:, 0]
    context, turn = copies.context, copies.turn
    if context is not None and turn is not None:
        context, turn = take_turns(context, turn, done, params.visible.shape[0])
    state = world.restart(moved.state, done, noise, _own(params, context))
    elapsed = jnp.where(done, 0, copies.elapsed + 1)
    if world.time_limit == "terminal":
        terminated = done
    step = Step(moved.reward[:, 0], terminated, done, after)
    return Copies(state, elapsed, context, turn), step


def _look(world: Solo, params: Tree, copies: Copies) -> jax.Array:
    """(E, o) what the agents see."""
    return world.observe(copies.world, _own(params, copies.context)).obs[:, 0]


def take_turns(
    context: jax.Array, turn: jax.Array, done: jax.Array, n_contexts: int
) -> tuple[jax.Array, jax.Array]:
    """(E,) contexts after the copies that are done took the next ones, and whose turn is next."""
    taken = jnp.cumsum(done)
    context = jnp.where(done, (turn + taken - 1) % n_contexts, context)
    return context, (turn + taken[-1]) % n_contexts


def _own(params: Tree, context: jax.Array | None) -> Tree:
    """Parameters of the context of each copy, or of one context for all."""
    return params if context is None else jax.tree.map(lambda x: x[context], params)
