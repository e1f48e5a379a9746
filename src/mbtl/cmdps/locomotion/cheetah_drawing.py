"""Pictures of a half cheetah from the side, drawn from where its parts are: no OpenGL is needed."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.cmdps.canvas import Canvas, Image, Window

WIDTH = 480
"""Pixels."""
_VIEW, _SHAPE = 4.0, 0.5
"""Metres that are shown, and height by width."""
_SKY, _LIGHT, _DARK = (222, 230, 245), (150, 158, 168), (120, 128, 138)
_COLOURS = {"b": (150, 95, 40), "t": (205, 150, 80), "h": (205, 150, 80), "f": (225, 175, 110)}
"""By the first letter of a part: back leg, torso, head, front leg."""


def draw(model: Any, data: Any) -> Image:
    """What is around the cheetah; fields of the ground are one metre long.

    Args:
        model: `mujoco.MjModel`.
        data: `mujoco.MjData` of the moment, after its kinematics.

    Returns:
        (height, width, 3) uint8.
    """
    middle = float(data.qpos[0])
    left, bottom = middle - 0.5 * _VIEW, -0.12 * _VIEW
    window = Window(left, bottom, left + _VIEW, bottom + _SHAPE * _VIEW)
    canvas = Canvas(window, _SKY, WIDTH)
    for metre in range(int(np.floor(left)), int(np.ceil(left + _VIEW))):
        field = [(metre, 0.0), (metre + 1, 0.0), (metre + 1, bottom), (metre, bottom)]
        canvas.area(np.array(field, float), _DARK if metre % 2 else _LIGHT)
    for geom in range(1, model.ngeom):  # the first is the floor
        radius, half = model.geom_size[geom, :2]
        along = half * data.geom_xmat[geom].reshape(3, 3)[[0, 2], 2]
        place = data.geom_xpos[geom, [0, 2]]
        canvas.capsule(place - along, place + along, radius, _COLOURS[model.geom(geom).name[0]])
    return canvas.image()
