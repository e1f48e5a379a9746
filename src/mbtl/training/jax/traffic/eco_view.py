"""What agents of the eco-driving twin see: `mbtl.cmdps.traffic.eco.LAYOUT`.

Notation as in `mbtl.training.jax.traffic.eco`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from mbtl.training.jax.traffic.eco_state import EcoParams, EcoState, Look, Road
from mbtl.training.jax.traffic.signal import Light
from mbtl.training.jax.traffic.twin import Seen

_SIDES = 4  # neighbours on other lanes: as there are none, the car itself


def view(
    road: Road, light: Light, look: Look, dt: float, state: EcoState, params: EcoParams
) -> Seen:
    """Observations of all agents; nonsense where there is none.

    Args:
        road: geometry.
        light: the signals.
        look: scales.
        dt: seconds of a step.
        state: of n roads.
        params: of their contexts.
    """
    main, mine = state.main, jnp.maximum(state.row, 0)
    ahead, behind = jnp.maximum(mine - 1, 0), jnp.minimum(mine + 1, main.x.shape[0] - 1)
    tail = main.x - main.length

    def of(field: jax.Array, row: jax.Array) -> jax.Array:
        return jnp.take_along_axis(field, row, axis=0, mode="promise_in_bounds")

    def neighbour(there: jax.Array, speed: jax.Array, gap: jax.Array) -> list[jax.Array]:
        seen = (speed / look.speed, gap / look.length, jnp.float32(0.0), jnp.float32(0.0))
        return [jnp.where(there, x, a) for x, a in zip(seen, look.absent, strict=True)]

    x, speed, own_tail, next_x = (
        of(main.x, mine),
        of(main.speed, mine),
        of(tail, mine),
        of(main.x, behind),
    )
    signal = light.seen(params.green, state.steps * dt)
    numbers = [
        speed / look.speed,
        (road.line - x) / look.length,
        *signal[:3],
        *(seconds / look.time for seconds in signal[3:]),
        x <= road.line,
        (x > road.line) & (x <= road.box),
        x > road.box,
        *map(jnp.float32, (0.0, 0.0, 1.0, 0.0)),  # the only lane, and straight on
        *neighbour(mine > 0, of(main.speed, ahead), of(tail, ahead) - x),
        *neighbour((behind > mine) & (next_x > 0.0), of(main.speed, behind), own_tail - next_x),
        *[speed / look.speed, *map(jnp.float32, (0.0, 0.0, 0.0))] * _SIDES,
    ]
    shape = state.row.shape
    columns = [jnp.broadcast_to(column, shape).astype(jnp.float32).T for column in numbers]
    visible = params.visible if params.visible.ndim == 2 else params.visible[None]
    shown = jnp.broadcast_to(visible[:, None], (*shape[::-1], visible.shape[-1]))
    obs = jnp.concatenate([jnp.stack(columns, axis=-1), shown], axis=-1)
    return Seen(obs, (state.row >= 0).T)
