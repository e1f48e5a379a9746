"""Pictures of any running simulation: lanes, stop lines in the colour of their light, cars.

Everything is asked from the simulation, so a new network needs no drawing code. A picture of 22
cars takes milliseconds.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.canvas import Canvas, Image, Window

MARGIN = 4.0
"""Metres around the network."""
SMALLEST = 3.0
"""Pixels that a car is wide at least, where the scale would hide it."""
FASTEST = 14.0
"""Speed [m/s] at which a car has the colour of free flow."""

_GRASS, _ROAD = (236, 238, 230), (92, 96, 102)
_STOPPED, _FREE = np.array([200.0, 30.0, 30.0]), np.array([250.0, 235.0, 90.0])
_CONTROLLED, _HALO = (20, 90, 220), (255, 255, 255)
Legend = tuple[tuple[tuple[int, int, int], str], ...]
"""Colours and what they mean."""
CARS: Legend = (((200, 30, 30), "stands"), ((225, 132, 60), "half speed"), ((250, 235, 90), "free"))
CONTROLLED = (_CONTROLLED, "controlled")
_LIGHTS = {"G": (40, 170, 70), "g": (40, 170, 70), "y": (245, 170, 20), "r": (220, 40, 40)}


def draw(api: Any, window: Window | None = None, controlled: Collection[str] = ()) -> Image:
    """The network, its lights and its cars, coloured from red (standing) to yellow (free).

    Args:
        api: a running simulation, libsumo or a TraCI connection.
        window: what to show; None: the whole network.
        controlled: cars that are marked: blue, with a white edge, and drawn last.

    Returns:
        (height, width, 3) uint8; north is up.

    Raises:
        InvalidInput: the window has no area.
    """
    lanes = {id: _flat(api.lane.getShape(id)) for id in api.lane.getIDList()}
    if window is None:
        points = np.concatenate(list(lanes.values()))
        window = Window(*(points.min(axis=0) - MARGIN), *(points.max(axis=0) + MARGIN))
    canvas = Canvas(window, _GRASS)
    for id in api.junction.getIDList():
        try:
            shape = api.junction.getShape(id)
        except struct.error:  # TraCI cannot read the empty shape of a dead end
            continue
        if len(shape) > 2:
            canvas.area(_flat(shape), _ROAD)
    for id, shape in lanes.items():
        canvas.line(shape, api.lane.getWidth(id), _ROAD)
    for end, along, width, colour in _stop_lines(api, lanes):
        across = np.array([-along[1], along[0]]) * width / 2.0
        canvas.line(np.array([end - across, end + across]), canvas.at_least(1.0), colour)
    cars = api.vehicle.getIDList()
    for car in sorted(cars, key=lambda car: car in controlled):
        _draw_car(canvas, api.vehicle, car, car in controlled)
    return canvas.image()


def _flat(shape: Any) -> Array:
    """(n, 2), without heights."""
    return np.array([point[:2] for point in shape], dtype=float)


def _draw_car(canvas: Canvas, vehicle: Any, car: str, controlled: bool) -> None:
    angle = math.radians(vehicle.getAngle(car))  # 0: north, clockwise
    front = np.array(vehicle.getPosition(car))
    width = canvas.at_least(vehicle.getWidth(car), SMALLEST)
    length = max(vehicle.getLength(car), 1.5 * width)
    back = front - length * np.array([math.sin(angle), math.cos(angle)])
    free = min(max(vehicle.getSpeed(car), 0.0) / FASTEST, 1.0)
    if controlled:
        edge = canvas.at_least(0.0, 1.5)
        along = (front - back) / length * edge
        canvas.line(np.array([back - along, front + along]), width + 2.0 * edge, _HALO)
    colour = _CONTROLLED if controlled else tuple(_STOPPED + free * (_FREE - _STOPPED))
    canvas.line(np.array([back, front]), width, colour)


def _stop_lines(
    api: Any, lanes: dict[str, Array]
) -> Iterator[tuple[Array, Array, float, tuple[int, ...]]]:
    """(end of the lane, its direction, its width, colour) of each lane with a light.

    A lane with several links has the colour of the one that lets most pass.
    """
    for light in api.trafficlight.getIDList():
        shown: dict[str, str] = {}
        state = api.trafficlight.getRedYellowGreenState(light)
        for links, letter in zip(api.trafficlight.getControlledLinks(light), state, strict=False):
            for lane, *_ in links:
                shown[lane] = min(shown.get(lane, "r"), letter, key="Ggyr".find)
        for lane, letter in shown.items():
            before, end = lanes[lane][-2:]
            along = (end - before) / max(float(np.hypot(*(end - before))), 1e-9)
            yield end, along, api.lane.getWidth(lane), _LIGHTS.get(letter, _LIGHTS["r"])
