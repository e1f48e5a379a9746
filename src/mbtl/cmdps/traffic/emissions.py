"""Emissions: CO2 of a car from its speed and acceleration, after VT-CPFM (cmdp-spec, 6.3).

Notation: v speed [m/s], a acceleration [m/s^2], R resistance [N], P power [kW], F fuel [L/s].

    R = 2.372 v^2 + 1.785 v + 1.785 N        drag, rolling, and the grade term N
    P = (R + 3278 a) v / 3312
    F = 7.8e-4 + 1.956e-5 P + 1e-6 P^2       P < 0: 7.8e-4, the engine idles
    CO2 = 2350 F                             grams per second

The road is level: N = 0. The spec gives no unit of v. We read metres per second throughout:
cruising at 10 and 14 m/s then costs 1.9 g/s, and 3.8 g/s with +2 m/s^2 at 10 m/s; the reference's
MOVES surrogate has 0-0.5, 1-2.8 and 9 g/s there, and kilometres per hour would make it 6, 26 and
33 g/s. One engine stands for the whole fleet, as the spec has constants for one.

Only arithmetic, so that floats, NumPy arrays and JAX arrays all go through.
"""

from __future__ import annotations

from typing import TypeVar

from mbtl.arrays import Array

Number = TypeVar("Number", float, Array)

DRAG, ROLLING, INERTIA, EFFICIENCY = 2.372, 1.785, 3278.0, 3312.0
IDLE, LINEAR, SQUARE = 7.8e-4, 1.956e-5, 1e-6
CO2_PER_LITRE = 2350.0
"""Grams of CO2 from a litre of fuel."""
GRADE = 0.0


def power(speed: Number, acceleration: Number) -> Number:
    """Power at the wheels [kW]; negative where the car brakes."""
    resistance = DRAG * speed * speed + ROLLING * speed + ROLLING * GRADE
    return (resistance + INERTIA * acceleration) * speed / EFFICIENCY


def fuel_rate(speed: Number, acceleration: Number) -> Number:
    """Fuel [L/s]."""
    needed = power(speed, acceleration)
    positive = (needed + abs(needed)) / 2.0
    return IDLE + LINEAR * positive + SQUARE * positive * positive


def co2_rate(speed: Number, acceleration: Number) -> Number:
    """CO2 [g/s].

    Args:
        speed: v [m/s], >= 0.
        acceleration: a [m/s^2], of the same shape.
    """
    return CO2_PER_LITRE * fuel_rate(speed, acceleration)
