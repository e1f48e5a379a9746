"""Pictures without a plotting library: polygons filled into an array that is addressed in metres.

Shapes are convex polygons drawn at twice the resolution, which is then averaged.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.errors import InvalidInput

__all__ = ["Canvas", "Image", "Window"]

Image = NDArray[np.uint8]
"""(height, width, 3)"""

LONG_SIDE, SHORT_SIDE = 800, 120
"""Pixels of the longer side, and the fewest of the shorter."""

_OVERSAMPLING = 2
_BEND = 0.2
"""Pieces of a line overlap by this share of half their width: no gaps in bends up to 22 degrees."""


_TURNS = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
_ROUND = np.stack([np.cos(_TURNS), -np.sin(_TURNS)], axis=1)
"""A circle, clockwise."""


class Window(NamedTuple):
    """A rectangle [m]."""

    left: float
    bottom: float
    right: float
    top: float


class Canvas:
    """An array of pixels that is addressed in metres."""

    def __init__(
        self, window: Window, colour: tuple[int, int, int], long_side: int = LONG_SIDE
    ) -> None:
        """Empty.

        Args:
            window: what to show.
            colour: of what nothing is drawn on.
            long_side: pixels of the longer side.

        Raises:
            InvalidInput: the window has no area.
        """
        size = np.array([window.right - window.left, window.top - window.bottom])
        if not (size > 0.0).all():
            raise InvalidInput(f"a window must have left < right and bottom < top, got {window}")
        scale = long_side / float(size.max())
        pixels = np.maximum(np.ceil(size * scale - 1e-9), SHORT_SIDE).astype(int)
        middle = np.array([window.left + window.right, window.bottom + window.top]) / 2.0
        self._scale = scale * _OVERSAMPLING
        self._corner = middle + np.array([-1.0, 1.0]) * pixels / scale / 2.0
        width, height = pixels * _OVERSAMPLING
        self._pixels = np.full((height, width, 3), colour, dtype=np.uint8)

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
        came, goes = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
        turns = came[:, 0] * goes[:, 1] - came[:, 1] * goes[:, 0]
        if (turns <= 0.0).all() or (turns >= 0.0).all():  # convex: all at once
            self._fill(points if turns.sum() < 0.0 else points[::-1], colour)
            return
        middle = points.mean(axis=0)
        for a, b in zip(points, np.roll(points, -1, axis=0), strict=True):
            turn = (a - middle)[0] * (b - middle)[1] - (a - middle)[1] * (b - middle)[0]
            self._fill(np.array([middle, b, a] if turn > 0.0 else [middle, a, b]), colour)

    def disc(self, middle: Array, radius: float, colour: tuple[float, ...]) -> None:
        """A disc around `middle` (2,) [m]."""
        self._fill(middle + radius * _ROUND, colour)

    def capsule(self, start: Array, end: Array, radius: float, colour: tuple[float, ...]) -> None:
        """A line with round ends, from (2,) to (2,) [m]."""
        self.line(np.array([start, end]), 2.0 * radius, colour)
        self.disc(start, radius, colour)
        self.disc(end, radius, colour)

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
