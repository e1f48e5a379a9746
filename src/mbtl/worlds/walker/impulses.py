"""What motors, limits of joints and the ground do in a step: impulses, found one after another.

Box2D's equations and its order. As joints hold exactly here, and only they make it slow to
converge, a sixth of Box2D's 180 rounds is enough.

Notation: d numbers move a thing; r rows, each a direction in which something moves, as fast as
row . u. Shapes are of one walker; those of many come last, see `body`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mbtl.worlds.walker.body import dot

ROUNDS = 30
SLOP, FURTHEST = 0.005, 0.2
"""Overlap that nobody mends, and the most that is mended at once [m]."""


class Rows(NamedTuple):
    """Directions of impulses.

    Attributes:
        row: (r, d).
        effect: (r, d) what an impulse of 1 does to u.
        ease: (r,) how large an impulse stops a motion of 1; 0 where there is none.
    """

    row: jax.Array
    effect: jax.Array
    ease: jax.Array

    @classmethod
    def of(cls, row: jax.Array, inverse: jax.Array, valid: jax.Array | bool = True) -> Rows:
        """Rows of a thing with a mass matrix whose inverse is (d, d)."""
        effect = dot([row[:, i, None] for i in range(len(inverse))], inverse)
        size = dot(jnp.swapaxes(row, 0, 1), jnp.swapaxes(effect, 0, 1))
        return cls(row, effect, jnp.where(valid, 1.0 / jnp.where(valid, size, 1.0), 0.0))

    def along(self, number: int, u: jax.Array) -> jax.Array:
        """How fast the thing moves along one of them; in a round, where each sum is one kernel."""
        return (self.row[number] * u).sum(axis=0)


class Ground(NamedTuple):
    """Points at which something touches the ground, (c,) rows along it and away from it."""

    along: Rows
    away: Rows
    friction: jax.Array

    def push(self, u: jax.Array, pushed: Any) -> tuple[jax.Array, Any]:
        """One round: friction, at most in proportion to the pressure, then pressure."""
        along, away, after = self.along, self.away, []
        for i, (rubbed, pressed) in enumerate(pushed):
            most = self.friction * pressed
            rub = jnp.clip(rubbed - along.along(i, u) * along.ease[i], -most, most)
            u = u + along.effect[i] * (rub - rubbed)
            press = jnp.maximum(pressed - away.along(i, u) * away.ease[i], 0.0)
            u = u + away.effect[i] * (press - pressed)
            after.append((rub, press))
        return u, after

    def untouched(self) -> Any:
        """Impulses before the first round."""
        none = jnp.zeros_like(self.away.ease[0])
        return [(none, none)] * len(self.away.ease)

    def lift(self, moved: jax.Array, gaps: jax.Array, share: float) -> jax.Array:
        """One round of moving things out of the ground, `share` of the overlap at a time."""
        away = self.away
        for i in range(len(gaps)):
            wrong = share * (gaps[i] + dot(away.row[i], moved) + SLOP)
            moved = moved - away.effect[i] * (jnp.clip(wrong, -FURTHEST, 0.0) * away.ease[i])
        return moved

    def overlap(self, moved: jax.Array, gaps: jax.Array) -> jax.Array:
        """The deepest one that is left, <= 0 [m]."""
        left = gaps + dot(jnp.swapaxes(self.away.row, 0, 1), moved[:, None])
        return jnp.where(self.away.ease > 0.0, left, 0.0).min(axis=0)


class Joints(NamedTuple):
    """Four joints with motors and limits.

    Attributes:
        motors: rows that turn the joints.
        wanted: (4,) speeds [rad/s].
        strongest: (4,) impulses [N m s].
        limits: rows that turn joints away from the limit that they are at.
    """

    motors: Rows
    wanted: jax.Array
    strongest: jax.Array
    limits: Rows

    def push(self, u: jax.Array, pushed: Any) -> tuple[jax.Array, Any]:
        """One round: motors, as strong as they may be, then limits."""
        driven, held = [], []
        for i, before in enumerate(pushed[0]):
            short = (self.wanted[i] - self.motors.along(i, u)) * self.motors.ease[i]
            most = self.strongest[i]
            driven.append(jnp.clip(before + short, -most, most))
            u = u + self.motors.effect[i] * (driven[-1] - before)
        for i, before in enumerate(pushed[1]):
            back = self.limits.along(i, u) * self.limits.ease[i]
            held.append(jnp.maximum(before - back, 0.0))
            u = u + self.limits.effect[i] * (held[-1] - before)
        return u, (driven, held)

    def still(self) -> Any:
        """Impulses before the first round."""
        none = [jnp.zeros_like(self.wanted[0])] * len(self.wanted)
        return none, none


def settled(u: jax.Array, joints: Joints, ground: Ground, rounds: int = ROUNDS) -> jax.Array:
    """(7,) speeds after all impulses of a step."""

    def one(_: int, carry: Any) -> Any:
        u, turned, pressed = carry
        u, turned = joints.push(u, turned)
        u, pressed = ground.push(u, pressed)
        return u, turned, pressed

    start = u, joints.still(), ground.untouched()
    settled: jax.Array = jax.lax.fori_loop(0, rounds, one, start)[0]
    return settled
