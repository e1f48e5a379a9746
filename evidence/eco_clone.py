"""Fit a small network to the rule `glide, try for green`: what recipe `glide` begins with.

Observations are made up, not played: any speed, place, moment of the cycle and neighbours. Where
the rule lets a driver drive, any advice above the limit is right. Prints the mean error of advised
speeds where the rule advises, and how often the network advises a car that should be let alone.

example: python evidence/eco_clone.py --write src/mbtl/zoo/worlds/traffic/rules/glide.npz
"""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

import numpy as np

import mbtl.engine.learners  # noqa: F401  isort: skip  # first: flags of jax
import jax
import jax.numpy as jnp
import optax

from mbtl.engine.learners import networks
from mbtl.engine.worlds.environments import Box
from mbtl.zoo.cmdps.traffic import eco
from mbtl.zoo.worlds.traffic.eco import Light

GLIDE = {"margin": 1.0, "share": 0.55, "floor": 1.7, "tries": -2.7, "reach": 250.0}
"""Seconds, a share, m/s, seconds and metres of the rule."""
HIDDEN = (64, 64)
ROWS = 512
ALONE = 1.15
"""Advice, as a share of the limit, that is no advice."""
LIGHT = Light(eco.YELLOW, eco.RED)


def made_up(key: Any, n: int) -> Any:
    """(n, 39) observations; four fifths before the line, a third of the greens the usual one."""
    draw = jax.random.uniform(key, (13, n))
    ahead = eco.APPROACH - eco.LENGTH * draw[1]
    left = jnp.where(draw[0] < 0.8, eco.APPROACH * draw[1], ahead)
    moving = jnp.where(draw[2] < 0.35, 12.0 + 2.0 * draw[3], eco.LIMIT * draw[3])
    speed = jnp.where(draw[2] < 0.12, 0.0, moving)
    green = jnp.where(draw[4] < 0.3, 35.0, jnp.ceil(50.0 * draw[5]))
    time = jnp.floor(2.0 * draw[6] * LIGHT.cycle(green)) / 2.0
    signal = LIGHT.seen(green, time)
    x = eco.APPROACH - left
    nothing, one = jnp.zeros(n), jnp.ones(n)

    def other(there: Any, speed: Any, gap: Any) -> list[Any]:
        near = -jnp.log(1.0 - 0.999 * gap) * 30.0
        seen = (eco.LIMIT * speed / eco.SPEED_SCALE, near / eco.LENGTH_SCALE, 0.0, 0.0)
        return [jnp.where(there < 0.2, a, b) for a, b in zip(eco.ABSENT, seen, strict=True)]

    own = speed / eco.SPEED_SCALE
    box = eco.STARTS[2]
    columns = [
        own, left / eco.LENGTH_SCALE, *signal[:3], *(s / eco.TIME_SCALE for s in signal[3:]),
        x <= eco.APPROACH, (x > eco.APPROACH) & (x <= box), x > box,
        nothing, nothing, one, nothing, *other(*draw[7:10]), *other(*draw[10:13]),
        *[own, nothing, nothing, nothing] * 4,
    ]  # fmt: skip
    return jnp.stack([jnp.asarray(column, jnp.float32) for column in columns], axis=-1)


def glide(obs: Any) -> tuple[Any, Any]:
    """Speeds [m/s] that the rule wishes, and where it does.

    Arrive at the light when it turns green: v = max(floor, share d / (time to green + margin)),
    at d metres from the line, nearer than reach; who can make this green drives on. A share below 1
    is slow first and catches up.
    """
    speed, left = eco.SPEED_SCALE * obs[..., 0], eco.LENGTH_SCALE * obs[..., 1]
    green, changes = obs[..., 2] > 0.0, eco.TIME_SCALE * obs[..., 5:7]
    ride = jnp.maximum(left, 0.0) / (0.5 * (speed + 14.0))
    makes = green & (ride + GLIDE["tries"] < changes[..., 0])
    wait = jnp.where(green, changes[..., 1], changes[..., 0]) + GLIDE["margin"]
    wish = jnp.maximum(GLIDE["share"] * left / jnp.maximum(wait, 0.5), GLIDE["floor"])
    return wish, (left > 0.0) & (left < GLIDE["reach"]) & ~makes


def wanted(obs: Any) -> tuple[Any, Any]:
    """(n,) advice as a share of the limit, and whether there is any."""
    wish, acts = glide(obs)
    acts &= wish < eco.LIMIT
    return jnp.where(acts, wish / eco.LIMIT, ALONE), acts


def loss(actor: Any, key: Any) -> Any:
    """Mean of Huber's error; advice above what is no advice costs nothing there."""
    obs = made_up(key, ROWS)
    advice, acts = wanted(obs)
    apart = networks.apply(actor, obs)[:, 0] - advice
    apart = jnp.where(acts, apart, jnp.minimum(apart, 0.0))
    return optax.huber_loss(apart, delta=0.1).mean()


@partial(jax.jit, static_argnums=1)
def fitted(actor: Any, steps: int) -> Any:
    """The network after so many steps of Adam."""
    optimizer = optax.adam(optax.cosine_decay_schedule(4e-3, steps))

    def one(carry: Any, key: Any) -> tuple[Any, None]:
        actor, moments = carry
        change, moments = optimizer.update(jax.grad(loss)(actor, key), moments)
        return (optax.apply_updates(actor, change), moments), None

    keys = jax.random.split(jax.random.key(0), steps)
    (actor, _), _ = jax.lax.scan(one, (actor, optimizer.init(actor)), keys)
    return actor


def main() -> None:
    """Fit, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=3000, help="of Adam")
    parser.add_argument("--write", help="file for the layers")
    args = parser.parse_args()
    box = Box((0.0,), (1.0,))
    *layers, (matrix, bias) = networks.init_weights(0, eco.SIZE, box, HIDDEN).actor
    fresh = (*layers, (matrix, bias + np.float32(0.8)))  # begins as a car that drives on
    actor = fitted(jax.tree.map(jnp.asarray, fresh), args.steps)
    obs = made_up(jax.random.key(1), 20_000)
    advice, acts = wanted(obs)
    found = networks.apply(actor, obs)[:, 0]
    error = float(eco.LIMIT * jnp.abs(found - advice)[acts].mean())
    slowed = float((found < 0.95)[~acts].mean())
    if args.write:
        layers = [np.asarray(x, np.float32) for x in jax.tree.leaves(actor)]
        names = [f"{what}_{k}" for k in range(len(layers) // 2) for what in ("weight", "bias")]
        np.savez(args.write, **dict(zip(names, layers, strict=True)))
    print(f"error {error:.2f} m/s where the rule advises; advises {100 * slowed:.1f} % of the rest")


if __name__ == "__main__":
    main()
