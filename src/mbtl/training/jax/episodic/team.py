"""Agents that share one reward: what one does is worth what the team earns until the episode ends.

As in `mbtl.training.shared`: credited with its own life only, an agent that drives on is paid less
than one that stays and sees others arrive.
"""

from __future__ import annotations

from typing import Literal

import jax
import jax.numpy as jnp

from mbtl.training.jax.episodic.episodes import Episodes

Credit = Literal["own", "team"]
"""Whose rewards an action is worth: the agent's until it leaves, or the team's until the end."""


def of_team(lived: Episodes) -> Episodes:
    """The same episodes as the team lives through them: one reward, one value, no end before all.

    Its reward and value are the means of those of the agents who act, in every place.
    """

    def shared(x: jax.Array, who: jax.Array) -> jax.Array:
        total = jnp.where(who, x, 0.0).sum(axis=-1, keepdims=True)
        mean = total / jnp.maximum(who.sum(axis=-1, keepdims=True), 1)
        return jnp.broadcast_to(mean, x.shape)

    someone = lived.last_acting.any(axis=-1, keepdims=True)
    return lived._replace(
        reward=shared(lived.reward, lived.acting),
        value=shared(lived.value, lived.acting),
        acting=jnp.ones_like(lived.acting),
        done=jnp.zeros_like(lived.done),
        last_value=shared(lived.last_value, lived.last_acting),
        last_acting=jnp.broadcast_to(someone, lived.last_acting.shape),
    )
