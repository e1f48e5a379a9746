"""Random numbers as a function of (seed, moment, car): cheap, and the same in any company.

One number is two rounds of a 32-bit integer mixer, a fifth of the cost of jax's threefry; driver
noise is drawn for every car at every simulation step and would otherwise be half of the time.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

_GOLDEN = 0x9E3779B9
_MULTIPLIERS = (0x7FEB352D, 0x846CA68B)  # found by C. Wellons's search for low bias


def bits(
    seed: jax.Array, stream: int, moment: jax.Array, count: int, of: int | None = None
) -> jax.Array:
    """Random integers of 32 bits.

    Args:
        seed: (n,) uint32, one per simulation.
        stream: what they are for; keeps uses apart.
        moment: scalar integer, e.g. the number of the simulation step; or (n,).
        count: numbers per simulation, e.g. one per car.
        of: so many belong to a moment, of which the first ones are drawn; None: all.

    Returns:
        (count, n) uint32.
    """
    first = jnp.atleast_1d(moment.astype(jnp.uint32)) * jnp.uint32(of or count)
    index = first[None, :] + jnp.arange(count, dtype=jnp.uint32)[:, None]
    place = mix(index + jnp.uint32((stream * _GOLDEN) & 0xFFFFFFFF))
    return mix(mix(seed + jnp.uint32(_GOLDEN))[None, :] ^ place)


def uniform(
    seed: jax.Array, stream: int, moment: jax.Array, count: int, of: int | None = None
) -> jax.Array:
    """(count, n) uniform in (0, 1); arguments as in `bits`."""
    high = bits(seed, stream, moment, count, of) >> 9
    return (high.astype(jnp.float32) + 0.5) * jnp.float32(2.0**-23)


def normal(seed: jax.Array, stream: int, moment: jax.Array, count: int) -> jax.Array:
    """(count, n) standard normal; arguments as in `bits`."""
    centred = 2.0 * uniform(seed, stream, moment, count) - 1.0
    return jnp.float32(2.0**0.5) * jax.lax.erf_inv(centred)


def coins(seed: jax.Array, stream: int, moment: jax.Array, count: int) -> jax.Array:
    """(count, n) nearly normal: how many of 32 coins show heads, with mean 0 and deviation 1.

    A third of the cost of `normal`, for what is added up over many steps; the excess kurtosis is
    -1/16. Arguments as in `bits`.
    """
    heads = jax.lax.population_count(bits(seed, stream, moment, count))
    return (heads.astype(jnp.float32) - 16.0) * jnp.float32(8.0**-0.5)


def mix(x: jax.Array) -> jax.Array:
    """A bijection of 32-bit integers in which every input bit changes half of the output bits."""
    x ^= x >> 16
    x *= jnp.uint32(_MULTIPLIERS[0])
    x ^= x >> 15
    x *= jnp.uint32(_MULTIPLIERS[1])
    return x ^ (x >> 16)
