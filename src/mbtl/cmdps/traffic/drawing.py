"""Pictures of any running simulation: lanes, stop lines in the colour of their light, cars.

Everything is asked from the simulation, so a new network needs no drawing code. Shapes are convex
polygons filled into an array at twice the resolution, which is then averaged: a picture of 22 cars
takes milliseconds and no plotting library.
"""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.errors import InvalidInput

Image = NDArray[np.uint8]
"""(height, width, 3)"""

LONG_SIDE, SHORT_SIDE = 800, 120
"""Pixels of the longer side, and the fewest of the shorter."""
MARGIN = 4.0
"""Metres around the network."""
SMALLEST = 3.0
"""Pixels that a car is wide at least, where the scale would hide it."""
FASTEST = 14.0
"""Speed [m/s] at which a car has the colour of free flow."""

_GRASS, _ROAD = (236, 238, 230), (92, 96, 102)
_STOPPED, _FREE = np.array([200.0, 30.0, 30.0]), np.array([250.0, 235.0, 90.0])
_LIGHTS = {"G": (40, 170, 70), "g": (40, 170, 70), "y": (245, 170, 20), "r": (220, 40, 40)}
_OVERSAMPLING = 2
_BEND = 0.2
"""Pieces of a line overlap by this share of half their width: no gaps in bends up to 22 degrees."""


class Window(NamedTuple):
    """A rectangle of the network [m]."""

    left: float
    bottom: float
    right: float
    top: float


def draw(api: Any, window: Window | None = None) -> Image:
    """The network, its lights and its cars, coloured from red (standing) to yellow (free).

    Args:
        api: a running simulation, libsumo or a TraCI connection.
        window: what to show; None: the whole network.

    Returns:
        (height, width, 3) uint8; north is up.

    Raises:
        InvalidInput: the window has no area.
    """
    lanes = {id: _flat(api.lane.getShape(id)) for id in api.lane.getIDList()}
    if window is None:
        points = np.concatenate(list(lanes.values()))
        window = Window(*(points.min(axis=0) - MARGIN), *(points.max(axis=0) + MARGIN))
    canvas = _Canvas(window)
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
    for car in api.vehicle.getIDList():
        _draw_car(canvas, api.vehicle, car)
    return canvas.image()


def _flat(shape: Any) -> Array:
    """(n, 2), without heights."""
    return np.array([point[:2] for point in shape], dtype=float)


def _draw_car(canvas: _Canvas, vehicle: Any, car: str) -> None:
    angle = math.radians(vehicle.getAngle(car))  # 0: north, clockwise
    front = np.array(vehicle.getPosition(car))
    width = canvas.at_least(vehicle.getWidth(car), SMALLEST)
    length = max(vehicle.getLength(car), 1.5 * width)
    back = front - length * np.array([math.sin(angle), math.cos(angle)])
    free = min(max(vehicle.getSpeed(car), 0.0) / FASTEST, 1.0)
    canvas.line(np.array([back, front]), width, tuple(_STOPPED + free * (_FREE - _STOPPED)))


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


class _Canvas:
    """An array of pixels that is addressed in metres."""

    def __init__(self, window: Window) -> None:
        size = np.array([window.right - window.left, window.top - window.bottom])
        if not (size > 0.0).all():
            raise InvalidInput(f"a window must have left < right and bottom < top, got {window}")
        scale = LONG_SIDE / float(size.max())
        pixels = np.maximum(np.ceil(size * scale - 1e-9), SHORT_SIDE).astype(int)
        middle = np.array([window.left + window.right, window.bottom + window.top]) / 2.0
        self._scale = scale * _OVERSAMPLING
        self._corner = middle + np.array([-1.0, 1.0]) * pixels / scale / 2.0
        width, height = pixels * _OVERSAMPLING
        self._pixels = np.full((height, width, 3), _GRASS, dtype=np.uint8)

    def at_least(self, metres: float, pixels: float = 2.0) -> float:
        """A width [m] that is seen."""
        return max(metres, pixels * _OVERSAMPLING / self._scale)

    def line(self, points: Array, width: float, colour: tuple[float, ...]) -> None:
        """A chain of rectangles along `points` (n, 2) [m]."""
        last = len(points) - 2
        for k, (start, end) in enumerate(itertools.pairwise(points)):
            length = float(np.hypot(*(end - start)))
            if length > 0.0:
                along = (end - start) * (width / 2.0 / length)
                side = np.array([-along[1], along[0]])
                start = start - (k > 0) * _BEND * along
                end = end + (k < last) * _BEND * along
                self._fill(np.array([start + side, end + side, end - side, start - side]), colour)

    def area(self, points: Array, colour: tuple[float, ...]) -> None:
        """A polygon (n, 2) [m] that can be overlooked from its middle."""
        middle = points.mean(axis=0)
        for a, b in zip(points, np.roll(points, -1, axis=0), strict=True):
            turn = (a - middle)[0] * (b - middle)[1] - (a - middle)[1] * (b - middle)[0]
            self._fill(np.array([middle, b, a] if turn > 0.0 else [middle, a, b]), colour)

    def _fill(self, corners: Array, colour: tuple[float, ...]) -> None:
        """A convex polygon, corners (n, 2) clockwise [m]: the pixels whose middles it holds."""
        height, width, _ = self._pixels.shape
        xy = (corners - self._corner) * (self._scale, -self._scale)
        low = np.maximum(np.floor(xy.min(axis=0)), 0.0).astype(int)
        high = np.minimum(np.ceil(xy.max(axis=0)), (width, height)).astype(int)
        if (low >= high).any():
            return
        x = np.arange(low[0], high[0])[None, :] + 0.5
        y = np.arange(low[1], high[1])[:, None] + 0.5
        inside = np.ones((high[1] - low[1], high[0] - low[0]), dtype=bool)
        for (ax, ay), (bx, by) in zip(xy, np.roll(xy, -1, axis=0), strict=True):
            inside &= (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0.0
        self._pixels[low[1] : high[1], low[0] : high[0]][inside] = np.array(colour, np.uint8)

    def image(self) -> Image:
        """The picture at its final resolution."""
        n = _OVERSAMPLING
        height, width, _ = self._pixels.shape
        total = np.zeros((height // n, width // n, 3), dtype=np.uint16)
        for row, column in itertools.product(range(n), repeat=2):
            total += self._pixels[row::n, column::n]
        image: Image = (total // n**2).astype(np.uint8)
        return image
