"""What all pictures share: the style file, new axes, and how a context axis is drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import wraps
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import Axis, Categorical, Log, Value
from mbtl.errors import needs, written

Draws = TypeVar("Draws", bound=Callable[..., Any])

GREY, DARK = "#777777", "#333333"
WIDTHS = (3.4, 5.2, 6.8)
"""Inches: one column of a paper, one picture of a page, two columns."""

_DISTINCT = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#d2d23c", "#695a1e", "#784bc3", "#c3003c",
    "#00e1ff", "#3c8700", "#d2d2c3", "#2d5a5a", "#ffb478", "#b40f87", "#c3c3ff", "#873c3c",
    "#a5e187", "#f087ff", "#2d87ff", "#b48700", "#ff8787", "#694b87", "#968796", "#00d278",
)  # fmt: skip


def style() -> AbstractContextManager[None]:
    """The project's style while the block runs, for axes of your own.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    with needs("matplotlib", "plots"):
        from matplotlib.style import context
    place = str(resources.files("mbtl.plot") / "mbtl.mplstyle")
    found: AbstractContextManager[None] = context(place)
    return found


def styled(draw: Draws) -> Draws:
    """Run a drawing function in the project's style, also on axes that are given."""

    @wraps(draw)
    def drawn(*args: Any, **kwargs: Any) -> Any:
        with style():
            return draw(*args, **kwargs)

    return cast(Draws, drawn)


def axes_for(ax: Any, width: float = WIDTHS[1], height: float = 3.2) -> Any:
    """The axes given, or those of a new figure that needs no display."""
    return new_figure(width, height).subplots() if ax is None else ax


def new_figure(width: float, height: float) -> Any:
    """A figure of its own, outside pyplot: nothing is kept and no window opens."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(ax: Any, path: str | Path) -> Path:
    """Write the figure of some axes; the ending chooses the format (png, pdf, svg).

    Args:
        ax: axes, an array of axes, or a figure.
        path: file to write; its folder is made.

    Raises:
        StorageError: `path` cannot be written.
    """
    place, first = Path(path), np.ravel(ax)[0]
    figure = first if hasattr(first, "savefig") else first.figure
    with style(), written(place):
        place.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(place)
    return place


def distinct(n: int) -> list[str]:
    """So many colours that are told apart at a glance, for things without an order.

    Each is as far as can be from all before it in CIELAB, and neither pale nor glaring; after 24
    they begin again.
    """
    return [_DISTINCT[i % len(_DISTINCT)] for i in range(n)]


# ---- one context axis ----------------------------------------------------------------------------


def positions(axis: Axis, values: Sequence[Value]) -> Array:
    """(N,) where values stand on a drawn axis: themselves, or the places of unordered choices."""
    if isinstance(axis, Categorical):
        return np.array([axis.choices.index(value) for value in values], dtype=np.float64)
    return np.asarray(values, dtype=np.float64)


def dress(ax: Any, axis: Axis, which: str = "x") -> None:
    """Label a drawn axis with name and unit; a logarithmic one is drawn as such."""
    drawn = ax.xaxis if which == "x" else ax.yaxis
    if isinstance(axis, Log):
        (ax.set_xscale if which == "x" else ax.set_yscale)("log")
        _plain_numbers(drawn, axis)
    if isinstance(axis, Categorical):
        drawn.set_ticks(range(len(axis.choices)), [str(choice) for choice in axis.choices])
    drawn.set_label_text(axis.label)


def _plain_numbers(drawn: Any, axis: Log) -> None:
    """Within two decades ticks are plain numbers at 1, 2 and 5, for 10 to some power is one."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    if axis.high / axis.low <= 100:
        drawn.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        drawn.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        drawn.set_minor_locator(NullLocator())


def edges(axis: Axis | None, levels: Array) -> Array:
    """(n + 1,) edges of the cells around rising levels, half-way as the axis is drawn."""
    if len(levels) == 1:
        near = abs(levels[0]) * 0.05 or 0.5
        return np.array([levels[0] - near, levels[0] + near])
    places = np.log(levels) if isinstance(axis, Log) else levels
    middle = (places[1:] + places[:-1]) / 2
    ends = [2 * places[0] - middle[0], *middle, 2 * places[-1] - middle[-1]]
    return np.exp(ends) if isinstance(axis, Log) else np.asarray(ends)


def number(
    ax: Any,
    places: Mapping[int, float],
    palette: Mapping[int, Any] | None = None,
    *,
    side: str = "top",
    line: str = GREY,
) -> None:
    """Numbers from 1 outside the axes at the contexts trained on, none of which hides another.

    Args:
        ax: axes whose scales are set.
        places: position of a policy -> place along the top, or up the right-hand side.
        palette: position of a policy -> colour.
        side: "top" or "right".
        line: colour of the dotted lines, where the palette has none.
    """
    if not places:
        return
    which, at, top = [*places], np.array([*places.values()]), side == "top"
    start = ax.get_ylim()[0] if top else ax.get_xlim()[0]
    there = np.full(len(at), start)
    points = np.column_stack([at, there] if top else [there, at])
    along = ax.transAxes.inverted().transform(ax.transData.transform(points))[:, 0 if top else 1]
    free: list[float] = []
    for i in np.argsort(along, kind="stable"):
        row = next((r for r, last in enumerate(free) if along[i] - last >= 0.035), len(free))
        free[row : row + 1] = [along[i]]
        colour = (palette or {}).get(which[i], line)
        (ax.axvline if top else ax.axhline)(
            at[i], color=colour, lw=0.9, ls=":", zorder=0 if top else 3
        )
        offset = 5 + 11 * row
        ax.annotate(
            str(which[i] + 1), (at[i], 1.0) if top else (1.0, at[i]),
            xycoords=("data", "axes fraction") if top else ("axes fraction", "data"),
            xytext=(0, offset) if top else (offset, 0), textcoords="offset points",
            fontsize=6.5, ha="center", va="center", annotation_clip=False,
            bbox={"boxstyle": "circle,pad=0.12", "fc": "white", "ec": colour if top else GREY},
        )  # fmt: skip


def cells(x: Array, y: Array, values: Array) -> tuple[Array, Array, Array]:
    """Values per context as a table over two axes; contexts of one cell are averaged.

    Returns:
        (nx,) and (ny,) levels, and (ny, nx) means, NaN where there is no context.
    """
    across, column = np.unique(x, return_inverse=True)
    up, row = np.unique(y, return_inverse=True)
    cell = row * len(across) + column
    count = np.bincount(cell, minlength=len(across) * len(up)).astype(float)
    total = np.bincount(cell, values, minlength=len(count))
    means = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    return across, up, means.reshape(len(up), len(across))
