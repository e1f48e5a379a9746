"""Two traffic lights of one cycle: the main one, and the ghost that takes turns with it upstream.

    green g | yellow | red | yellow        from time 0; the main light is red in the last two

The ghost shows the same to the straight feeder; to the side feeder it shows green in the third.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp


@dataclass(frozen=True)
class Light:
    """What all contexts share; `green` is an argument, a scalar or (n,), as are the results.

    Attributes:
        yellow: seconds.
        red: seconds from the end of one yellow to the beginning of the next.
    """

    yellow: float
    red: float

    def cycle(self, green: jax.Array) -> jax.Array:
        """Seconds from green to green."""
        return green + (2.0 * self.yellow + self.red)

    def straight(self, green: jax.Array, time: jax.Array) -> jax.Array:
        """Whether the main light, and the ghost to the straight feeder, show green."""
        return self._within(green, time) < green

    def side(self, green: jax.Array, time: jax.Array) -> jax.Array:
        """Whether the ghost shows green to the side feeder."""
        since = self._within(green, time) - green - self.yellow
        return (since >= 0.0) & (since < self.red)

    def seen(self, green: jax.Array, time: jax.Array) -> tuple[jax.Array, ...]:
        """The main light as cars see it.

        Returns:
            Green, yellow, red (one of them is 1), then the seconds until green next begins or ends
            and until the two changes after.
        """
        within, cycle = self._within(green, time), self.cycle(green)
        end, start = green - within, cycle - within
        shows_green, shows_red = end > 0.0, within >= green + self.yellow
        changes = (
            jnp.where(shows_green, end, start),
            jnp.where(shows_green, start, end + cycle),
            jnp.where(shows_green, end, start) + cycle,
        )
        phase = (shows_green, ~shows_green & ~shows_red, shows_red)
        return (*(x.astype(jnp.float32) for x in phase), *changes)

    def _within(self, green: jax.Array, time: jax.Array) -> jax.Array:
        return jnp.mod(time, self.cycle(green))
