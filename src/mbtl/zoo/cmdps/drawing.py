"""Pictures of the cart with its pole, and of the pendulum.

A mass is seen by its size, which grows with the cube root.
"""

from __future__ import annotations

import math

import numpy as np

from mbtl.canvas import Canvas, Image, Window

SIZE = 360
"""Pixels of the longer side."""
_PAPER, _GROUND, _INK = (246, 246, 242), (196, 200, 204), (60, 66, 74)
_POLE, _BODY = (200, 130, 60), (0, 114, 178)
_CART = 0.6  # m, of 1 kg
_BOB = 0.12  # of the length of a pendulum of 1 kg


def draw_cart(
    x: float, angle: float, *, length: float, cart: float, pole: float, reach: float
) -> Image:
    """The cart on its track, which ends where episodes do.

    Args:
        x: position [m].
        angle: of the pole from upright [rad].
        length: half the pole's [m].
        cart: mass of the cart [kg].
        pole: mass of the pole [kg].
        reach: length of the track to each side [m].

    Returns:
        (height, width, 3) uint8.
    """
    width = _CART * np.cbrt(cart)
    height = 0.5 * width
    tall = max(2.0 * length + height, 1.6)
    half = max(reach + 0.5 * width, 0.75 * tall)
    canvas = Canvas(Window(-half, -0.15 * tall, half, 1.1 * tall), _PAPER, SIZE)
    track = canvas.at_least(0.03, 3.0)
    canvas.line(np.array([[-half, 0.0], [half, 0.0]]), track, _GROUND)
    for end in (-reach, reach):
        canvas.line(np.array([[end, -3.0 * track], [end, 3.0 * track]]), track, _INK)
    box = np.array([[-0.5, 0.0], [0.5, 0.0], [0.5, 1.0], [-0.5, 1.0]]) * (width, height)
    canvas.area(box + np.array([x, 0.0]), _BODY)
    foot = np.array([x, height])
    tip = foot + 2.0 * length * np.array([math.sin(angle), math.cos(angle)])
    canvas.capsule(foot, tip, canvas.at_least(0.08 * float(np.cbrt(pole / 0.1)), 6.0) / 2.0, _POLE)
    canvas.disc(foot, canvas.at_least(0.05, 3.0), _INK)
    return canvas.image()


def draw_pendulum(angle: float, *, mass: float) -> Image:
    """The pendulum around its pivot, its length as the unit, and where it is to stand.

    Args:
        angle: from upright [rad].
        mass: [kg].

    Returns:
        (height, width, 3) uint8.
    """
    canvas = Canvas(Window(-1.3, -1.3, 1.3, 1.3), _PAPER, SIZE // 3 * 2)
    canvas.line(np.array([[0.0, 0.0], [0.0, 1.0]]), 0.02, _GROUND)
    tip = np.array([math.sin(angle), math.cos(angle)])
    canvas.capsule(np.zeros(2), tip, 0.05, _POLE)
    canvas.disc(tip, min(_BOB * float(np.cbrt(mass)), 0.25), _BODY)
    canvas.disc(np.zeros(2), 0.04, _INK)
    return canvas.image()
