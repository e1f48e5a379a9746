"""What agents of the eco-driving twin see: `mbtl.cmdps.traffic.eco.LAYOUT`.

Notation as in `mbtl.worlds.traffic.eco`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from mbtl.worlds.traffic.eco_state import EcoParams, EcoState, Look, Road
from mbtl.worlds.traffic.light import Light

_SIDES = 4  # neighbours on other lanes: as there are none, the car itself


def view(
    road: Road,
    light: Light,
    look: Look,
    dt: float,
    state: EcoState,
    params: EcoParams,
    simulation: jax.Array,
    place: jax.Array,
) -> jax.Array:
    """(..., f) observations of some agents; nonsense where there is none.

    Args:
        road: geometry.
        light: the signals.
        look: scales.
        dt: seconds of a step.
        state: of n roads.
        params: of their contexts.
        simulation: (...) the road of each agent.
        place: (...) its place there.
    """
    main, mine = state.main, jnp.maximum(state.row[place, simulation], 0)
    ahead, behind = jnp.maximum(mine - 1, 0), jnp.minimum(mine + 1, main.x.shape[0] - 1)

    def of(field: jax.Array, row: jax.Array) -> jax.Array:
        return field.at[row, simulation].get(mode="promise_in_bounds")

    def neighbour(there: jax.Array, speed: jax.Array, gap: jax.Array) -> list[jax.Array]:
        seen = (speed / look.speed, gap / look.length, jnp.float32(0.0), jnp.float32(0.0))
        return [jnp.where(there, x, a) for x, a in zip(seen, look.absent, strict=True)]

    x, speed, next_x = of(main.x, mine), of(main.speed, mine), of(main.x, behind)
    own_tail = x - of(main.length, mine)
    tail_ahead = of(main.x, ahead) - of(main.length, ahead)
    green = params.green if params.green.ndim == 0 else params.green[simulation]
    signal = light.seen(green, state.steps * dt)
    numbers = [
        speed / look.speed,
        (road.line - x) / look.length,
        *signal[:3],
        *(seconds / look.time for seconds in signal[3:]),
        x <= road.line,
        (x > road.line) & (x <= road.box),
        x > road.box,
        *map(jnp.float32, (0.0, 0.0, 1.0, 0.0)),  # the only lane, and straight on
        *neighbour(mine > 0, of(main.speed, ahead), tail_ahead - x),
        *neighbour((behind > mine) & (next_x > 0.0), of(main.speed, behind), own_tail - next_x),
        *[speed / look.speed, *map(jnp.float32, (0.0, 0.0, 0.0))] * _SIDES,
    ]
    shape = mine.shape
    columns = [jnp.broadcast_to(column, shape).astype(jnp.float32) for column in numbers]
    visible = params.visible if params.visible.ndim == 1 else params.visible[simulation]
    shown = jnp.broadcast_to(visible, (*shape, visible.shape[-1]))
    return jnp.concatenate([jnp.stack(columns, axis=-1), shown], axis=-1)
