"""What motors, limits of joints and the ground do in a step: impulses, found one after another.

Box2D's equations and its order. As joints hold exactly here, and only they make it slow to
converge, a sixth of Box2D's 180 rounds is enough.

Notation: d numbers move a thing; r rows, each a direction in which something moves, as fast as
row . u.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

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
        effect = (row[:, :, None] * inverse[None]).sum(1)
        size = (row * effect).sum(-1)
        return cls(row, effect, jnp.where(valid, 1.0 / jnp.where(valid, size, 1.0), 0.0))

    def along(self, u: jax.Array) -> jax.Array:
        """How fast each moves, of (r,) rows or of one."""
        return (self.row * u).sum(-1)


class Ground(NamedTuple):
    """Points at which something touches the ground, (c,) rows along it and away from it."""

    along: Rows
    away: Rows
    friction: jax.Array

    def push(self, u: jax.Array, pushed: Any) -> tuple[jax.Array, Any]:
        """One round: friction, at most in proportion to the pressure, then pressure."""

        def point(u: jax.Array, own: Any) -> tuple[jax.Array, Any]:
            along, away, rubbed, pressed = own
            most = self.friction * pressed
            rub = jnp.clip(rubbed - along.along(u) * along.ease, -most, most)
            u = u + along.effect * (rub - rubbed)
            press = jnp.maximum(pressed - away.along(u) * away.ease, 0.0)
            return u + away.effect * (press - pressed), (rub, press)

        after: tuple[jax.Array, Any] = jax.lax.scan(point, u, (self.along, self.away, *pushed))
        return after

    def untouched(self) -> Any:
        """Impulses before the first round."""
        none = jnp.zeros_like(self.away.ease)
        return none, none

    def lift(self, moved: jax.Array, gaps: jax.Array, share: float) -> jax.Array:
        """One round of moving things out of the ground, `share` of the overlap at a time."""

        def point(moved: jax.Array, own: Any) -> tuple[jax.Array, None]:
            away, gap = own
            wrong = share * (gap + away.along(moved) + SLOP)
            return moved - away.effect * jnp.clip(wrong, -FURTHEST, 0.0) * away.ease, None

        return jax.lax.scan(point, moved, (self.away, gaps))[0]

    def overlap(self, moved: jax.Array, gaps: jax.Array) -> jax.Array:
        """The deepest one that is left, <= 0 [m]."""
        return jnp.where(self.away.ease > 0.0, gaps + self.away.along(moved), 0.0).min()


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

        def motor(u: jax.Array, own: Any) -> tuple[jax.Array, jax.Array]:
            rows, wanted, most, before = own
            after = jnp.clip(before + (wanted - rows.along(u)) * rows.ease, -most, most)
            return u + rows.effect * (after - before), after

        def limit(u: jax.Array, own: Any) -> tuple[jax.Array, jax.Array]:
            rows, before = own
            after = jnp.maximum(before - rows.along(u) * rows.ease, 0.0)
            return u + rows.effect * (after - before), after

        driven, held = pushed
        u, driven = jax.lax.scan(motor, u, (self.motors, self.wanted, self.strongest, driven))
        u, held = jax.lax.scan(limit, u, (self.limits, held))
        return u, (driven, held)


def settled(u: jax.Array, joints: Joints, ground: Ground, rounds: int = ROUNDS) -> jax.Array:
    """(7,) speeds after all impulses of a step."""

    def one(_: int, carry: Any) -> Any:
        u, turned, pressed = carry
        u, turned = joints.push(u, turned)
        u, pressed = ground.push(u, pressed)
        return u, turned, pressed

    start = u, (jnp.zeros(4), jnp.zeros(4)), ground.untouched()
    settled: jax.Array = jax.lax.fori_loop(0, rounds, one, start)[0]
    return settled
