"""Columns: what the coordinates of a context space are, and where contexts lie for the models.

Notation (shapes): N contexts, D columns, A axes (a categorical axis has a column per level).
    axis  (D,)    which axis a column belongs to
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.contexts import Axis, Categorical, Log
from mbtl.errors import InvalidInput
from mbtl.models.transfer_kernel import Places


@dataclass(frozen=True)
class Columns:
    """What the columns of a context space are.

    Attributes:
        axis: (D,) index of the axis of each column, from 0 without gaps.
        ratios: (D,) True where equal ratios of the values have a meaning that x does not show yet:
            not on a logarithmic axis, where x shows them, nor on a categorical one.
    """

    axis: NDArray[np.intp]
    ratios: NDArray[np.bool_]

    @classmethod
    def of(cls, axes: Sequence[Axis], width: int) -> Columns:
        """Columns of these axes; with none given, `width` linear axes of one column each.

        Raises:
            InvalidInput: the axes do not have `width` columns together.
        """
        if not axes:
            return cls(np.arange(width), np.ones(width, dtype=bool))
        widths = [axis.width for axis in axes]
        if sum(widths) != width:
            raise InvalidInput(
                f"axes must have as many columns as the coordinates ({width}), got {sum(widths)} "
                f"of {len(axes)} axes; give the axes of the context space itself"
            )
        ratios = [not isinstance(axis, (Categorical, Log)) for axis in axes]
        return cls(np.repeat(np.arange(len(axes)), widths), np.repeat(ratios, widths))

    @property
    def count(self) -> int:
        """Number of axes A."""
        return int(self.axis[-1]) + 1

    def places(self, unit: Array, steps: Array) -> Places:
        """Where the contexts lie when every axis counts the same, whatever its number of columns.

        Args:
            unit: (N, D) unit-cube coordinates.
            steps: (N, D) grid steps.
        """
        plain = Places.of(unit, steps)
        z = np.where(self.ratios, plain.z, plain.x)
        if len(self.axis) == self.count:
            return Places(plain.x, z)
        scale = np.sqrt(len(self.axis) / self.count)  # distances are means over columns
        return Places(plain.x * scale, z * scale)
