"""Pictures of a walker on its ground."""

from __future__ import annotations

import numpy as np

from mbtl.arrays import Array
from mbtl.cmdps.canvas import Canvas, Image, Window
from mbtl.cmdps.locomotion.walker_body import END, STEP, Walker

WIDTH = 480
"""Pixels."""
_VIEW, _SHAPE = 14.0, 0.6
"""Metres that are shown, at least, and height by width."""
_SKY, _GROUND, _FLAG = (222, 230, 245), (120, 165, 96), (230, 60, 20)
_COLOURS = ((125, 70, 200), (90, 60, 120), (70, 45, 95), (190, 120, 190), (165, 95, 165))
"""Of hull, thigh and shin; thigh and shin of the other leg, which is nearer."""
_ORDER = (1, 2, 0, 3, 4)


def draw(walker: Walker) -> Image:
    """What is around the walker; the view widens with the hull.

    Returns:
        (height, width, 3) uint8.
    """
    parts = [_corners(body) for body in walker.bodies]
    x, y = (float(v) for v in walker.bodies[0].position)
    width = max(_VIEW, 2.0 * float(np.ptp(parts[0], axis=0).max()))
    left, bottom = x - 0.3 * width, y - 0.6 * _SHAPE * width
    window = Window(left, bottom, left + width, bottom + _SHAPE * width)
    canvas = Canvas(window, _SKY, WIDTH)
    first = np.searchsorted(walker.ground[0], (left - STEP, left + width))
    for ax, ay, ex, ey in walker.ground[:4, slice(*first)].T.astype(float):
        below = min(ay, ay + ey, bottom) - 1.0
        piece = [(ax, ay), (ax + ex + 0.01, ay + ey), (ax + ex + 0.01, below), (ax, below)]
        canvas.area(np.array(piece), _GROUND)
    height = float(walker.ground[1, int(END / STEP)])
    canvas.line(np.array([[END, height], [END, height + 2.0]]), canvas.at_least(0.05), _FLAG)
    for number in _ORDER:
        canvas.area(parts[number], _COLOURS[number])
    return canvas.image()


def _corners(body: object) -> Array:
    """(n, 2) of the polygon of a body [m]."""
    (fixture,) = body.fixtures  # type: ignore[attr-defined]  # Box2D has no types
    return np.array([tuple(body.transform * v) for v in fixture.shape.vertices])  # type: ignore[attr-defined]
