"""Eco-driving in the twin under any rule of behaviour: what `eco_causes.py` plays with.

A rule is a function of observations (n, A, f) and numbers of its own (n, k) that gives
accelerations (n, A). Simulations of one call may differ in context, seed and numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

import mbtl.engine.learners  # noqa: F401  isort: skip  # first: flags of jax
import jax
import jax.numpy as jnp

from mbtl.zoo.cmdps.traffic import eco
from mbtl.zoo.cmdps.traffic.twins import EcoProblem
from mbtl.zoo.worlds.traffic import lane

Rule = Callable[[Any, Any], Any]
Measures = dict[str, Any]
"""Name of a measure -> (contexts, seeds)."""

PROBLEM = EcoProblem(score="paper")
TWIN = PROBLEM([{}])[0]
HARD = eco.STRONGEST  # more than any car can: drive by yourself


def stacked(contexts: Sequence[Mapping[str, float]], each: int) -> Any:
    """Parameters of `each` simulations per context."""
    params = PROBLEM([dict(c) for c in contexts])[1]
    return jax.tree.map(lambda *x: jnp.repeat(jnp.stack(x), each, axis=0), *params)


@partial(jax.jit, static_argnums=(0, 1))
def play(rule: Rule | None, twin: Any, seeds: Any, params: Any, numbers: Any) -> Measures:
    """Whole episodes; None: unguided.

    Beside the twin's measures:

    `system` metres driven per second spent on the road, feeders and unfinished trips included;
    `step_reward` mean reward of a decision; `trip_return` rewards of an agent that has left.
    """

    def one(_: int, carry: Any) -> Any:
        state, metres, seconds, rewards, decisions, lives = carry
        if rule is None:
            acting, moved = (state.row >= 0).T, twin.drive(state, params)
        else:
            seen = twin.observe(state, params)
            told = rule(seen.obs, numbers)[..., None]
            acting, moved = seen.acting, twin.step(state, told, params)
        new = moved.state
        for cars in (new.main, new.side):
            there = cars.x > 0.5 * lane.EMPTY
            metres += jnp.where(there, cars.speed, 0.0).sum(axis=0)
            seconds += there.sum(axis=0)
        rewards += jnp.where(acting, moved.reward, 0.0).sum(axis=1)
        return (
            new, metres, seconds, rewards, decisions + acting.sum(axis=1),
            lives + (acting & moved.done).sum(axis=1),
        )  # fmt: skip

    zero = jnp.zeros(len(seeds))
    first = (twin.start(seeds, params), zero, zero, zero, zero, zero)
    state, metres, seconds, rewards, decisions, lives = jax.lax.fori_loop(
        0, twin.horizon, one, first
    )
    return twin.measures(state) | {
        "system": metres / jnp.maximum(seconds, 1.0),
        "step_reward": rewards / jnp.maximum(decisions, 1.0),
        "trip_return": rewards / jnp.maximum(lives, 1.0),
        "lives": lives,
    }


def run(
    rule: Rule | None,
    contexts: Sequence[Mapping[str, float]],
    seeds: Sequence[int],
    numbers: Any = (),
) -> Measures:
    """The same seeds in each context; `numbers` are one row for all, or one row per context."""
    n, each = len(contexts), len(seeds)
    rows = np.broadcast_to(np.asarray(numbers, np.float32), (n, np.shape(numbers)[-1]))
    same = jnp.asarray(np.tile(np.array(seeds, np.uint32), n))
    found = play(rule, TWIN, same, stacked(contexts, each), jnp.asarray(np.repeat(rows, each, 0)))
    return {name: np.asarray(x, float).reshape(n, each) for name, x in found.items()}


# ---- rules -------------------------------------------------------------------------------------


def accelerate(obs: Any, numbers: Any) -> Any:
    """One acceleration for ever."""
    return jnp.broadcast_to(numbers[:, :1], obs.shape[:-1])


def capped(obs: Any, numbers: Any) -> Any:
    """A speed limit of one's own."""
    return jnp.clip((numbers[:, :1] - eco.SPEED_SCALE * obs[..., 0]) / 0.5, eco.HARDEST, HARD)


def never_again(obs: Any, numbers: Any) -> Any:
    """Drive, but do not start again after a stop."""
    return jnp.where(eco.SPEED_SCALE * obs[..., 0] < numbers[:, :1], eco.HARDEST, HARD)


GLIDE = ("margin s", "share", "floor m/s", "try s", "reach m", "braking", "gap m")


def glide(obs: Any, numbers: Any) -> Any:
    """Arrive when the light turns green, not before; who can make this green drives on.

    v = max(floor, share d / (time to green + margin)), at d metres from the line, nearer than
    reach, braking no harder than told, only with so much gap to the leader. A share below 1 is slow
    first and catches up.
    """
    speed, gap = eco.SPEED_SCALE * obs[..., 0], eco.LENGTH_SCALE * obs[..., 16]
    wish, acts = glide_speed(obs, numbers)
    braking, least = (numbers[:, None, i] for i in (5, 6))
    told = jnp.maximum(jnp.clip((wish - speed) / 0.5, eco.HARDEST, HARD), -braking)
    return jnp.where(acts & (gap > least), told, HARD)


def glide_speed(obs: Any, numbers: Any) -> tuple[Any, Any]:
    """Speeds [m/s] that `glide` wishes, and where it does."""
    speed, left = eco.SPEED_SCALE * obs[..., 0], eco.LENGTH_SCALE * obs[..., 1]
    green, changes = obs[..., 2] > 0.0, eco.TIME_SCALE * obs[..., 5:7]
    margin, share, floor, tries, reach = (numbers[:, None, i] for i in range(5))
    ride = jnp.maximum(left, 0.0) / (0.5 * (speed + 14.0))
    makes = green & (ride + tries < changes[..., 0])
    wait = jnp.where(green, changes[..., 1], changes[..., 0]) + margin
    wish = jnp.maximum(share * left / jnp.maximum(wait, 0.5), floor)
    return wish, (left > 0.0) & (left < reach) & ~makes


KINDS = (glide, accelerate, capped, never_again)


def any_rule(obs: Any, numbers: Any) -> Any:
    """One of `KINDS`, by its index in the first column: one program plays them all."""
    kind = numbers[:, :1].astype(int)
    return jnp.choose(kind, [rule(obs, numbers[:, 1:]) for rule in KINDS], mode="clip")


def row_of(kind: Rule, *numbers: float) -> Any:
    """Numbers of `any_rule`."""
    return np.array([KINDS.index(kind), *numbers, *[0.0] * (len(GLIDE) - len(numbers))])


START = np.array([2.0, 0.7, 2.0, 0.0, 230.0, 6.0, 0.0])
SPREAD = np.array([3.0, 0.25, 1.5, 3.0, 60.0, 4.0, 15.0])
LEAST = np.array([-5.0, 0.2, 0.0, -8.0, 20.0, 0.3, -1.0])
MOST = np.array([15.0, 1.5, 8.0, 15.0, 300.0, 20.0, 100.0])


def searched(
    contexts: Sequence[Mapping[str, float]], rounds: int, *, tries: int = 12, seeds: int = 8
) -> Any:
    """(contexts, 7) numbers of `glide` by the cross-entropy method on the score.

    In every round `tries` rows per context are drawn and played with the same fresh seeds; the best
    third of them moves mean and deviation of the next.
    """
    rng = np.random.default_rng(0)
    n, best = len(contexts), tries // 3
    mean, spread = np.tile(START, (n, 1)), np.tile(SPREAD, (n, 1))
    for number in range(rounds):
        rows = mean[:, None] + spread[:, None] * rng.normal(size=(n, tries, 7))
        rows = np.clip(rows, LEAST, MOST)
        rows[:, 0] = mean
        drawn = range(number * seeds, (number + 1) * seeds)
        many = [c for c in contexts for _ in range(tries)]
        kinds = np.zeros((len(many), 1))
        numbers = np.concatenate([kinds, rows.reshape(-1, 7)], axis=1)
        score = run(any_rule, many, drawn, numbers)["score"].mean(axis=1)
        for k, order in enumerate(np.argsort(-score.reshape(n, tries), axis=1)[:, :best]):
            mean[k] = 0.3 * mean[k] + 0.7 * rows[k, order].mean(axis=0)
            spread[k] = 0.3 * spread[k] + 0.7 * rows[k, order].std(axis=0) + 0.02 * SPREAD
    return mean
