"""Maps over the contexts: a value per context, or which policy serves it and how well."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.arrays import Array
from mbtl.contexts import Axis, Categorical, ContextSpace, Value
from mbtl.errors import InvalidInput
from mbtl.plot.style import (
    GREY,
    axes_for,
    cells,
    colours,
    dress,
    edges,
    new_figure,
    number,
    positions,
    styled,
)
from mbtl.portfolio import Portfolio
from mbtl.study import Study

_MOST_BARS = 12
_BY = "by the episodes that chose"


@styled
def heatmap(
    space: ContextSpace,
    values: ArrayLike,
    *,
    label: str = "performance",
    sources: Sequence[int] = (),
    over: tuple[str, str] | None = None,
    ax: Any = None,
) -> Any:
    """A value per context: a map over two axes with its colour scale, a line over one.

    Args:
        space: the N contexts.
        values: (N,) one per context.
        label: what they are, with their unit.
        sources: contexts trained on, in order; each is marked with its number.
        over: names of the two axes of the map; None: the first two. Others are averaged.
        ax: axes to draw on; None: new ones.

    Raises:
        InvalidInput: `values` are not one per context.
    """
    shown = np.asarray(values, dtype=np.float64)
    if shown.shape != (space.n,):
        raise InvalidInput(f"values must be one per context ({space.n},), got {shown.shape}")
    ax = axes_for(ax, height=3.2 if space.d == 1 else 3.8)
    if space.d == 1:
        axis = space.axes[0]
        x = positions(axis, space.values(axis.name))
        order = np.argsort(x)
        ax.plot(x[order], shown[order], "-" if space.n > 60 else ".-")
        dress(ax, axis)
        ax.set_ylabel(label)
        number(ax, x[list(sources)])
        return ax
    first, second = _pair(space, over)
    x, y = (positions(axis, space.values(axis.name)) for axis in (first, second))
    mesh = _mesh(ax, first, second, cells(x, y, shown)[:3])
    ax.figure.colorbar(mesh, ax=ax, label=label)
    _mark(ax, x, y, sources)
    return ax


@styled
def policy_map(
    result: Study | Portfolio, *, over: tuple[str, str] | None = None, ax: Any = None
) -> Any:
    """Which policy serves which context, and how well.

    On one axis performance is drawn along it, coloured by policy; on two or more the map has a
    colour per policy, and the number of each at the context it was trained on. In a cell that
    several policies serve, because more axes are averaged, the one of most contexts counts.

    Args:
        result: a study with rows, or a portfolio.
        over: names of the two axes of the map; None: the first two.
        ax: axes to draw on; None: new ones.
    """
    space, routing = result.space, result.routing
    sources, route, served = routing.sources, routing.route, routing.served
    used = np.unique(route)
    palette = dict(
        zip(used[np.argsort([sources[i] for i in used])], colours(len(used)), strict=True)
    )
    if space.d == 1:
        ax = axes_for(ax, 6.4, 3.4)
        axis = space.axes[0]
        x = positions(axis, space.values(axis.name))
        order = np.argsort(x)
        ax.plot(x[order], served[order], lw=0.6, color=GREY, zorder=1)
        for i in used:
            mine = route == i
            ax.plot(x[mine], served[mine], "s", ms=3.5, color=palette[i], zorder=2)
        dress(ax, axis)
        ax.set_ylabel("performance")
        ax.set_title(f"which policy serves; performance {_BY}", fontsize=8)
        number(ax, x[list(sources)], palette)
        return ax
    ax = axes_for(ax, height=3.8)
    first, second = _pair(space, over)
    x, y = (positions(axis, space.values(axis.name)) for axis in (first, second))
    across, up, table, cell = cells(x, y, served)
    votes = np.zeros((len(sources), table.size))
    np.add.at(votes, (route, cell), 1.0)
    winner = np.where(np.isfinite(table.ravel()), votes.argmax(axis=0), -1)
    rank = {policy: place for place, policy in enumerate(palette)}
    codes = np.array([rank.get(w, np.nan) for w in winner]).reshape(table.shape)
    from matplotlib.colors import ListedColormap

    ax.pcolormesh(
        edges(first, across), edges(second, up), codes,
        cmap=ListedColormap(list(palette.values())), vmin=-0.5, vmax=len(palette) - 0.5,
        alpha=0.75,
    )  # fmt: skip
    dress(ax, first, "x")
    dress(ax, second, "y")
    if min(table.shape) > 1 and np.ptp(served) > 0 and np.isfinite(table).all():
        lines = ax.contour(across, up, table, 4, colors="black", linewidths=0.6, alpha=0.7)
        ax.clabel(lines, fontsize=6)
        ax.set_title(f"which policy serves; lines: performance {_BY}", fontsize=8)
    _mark(ax, x, y, sources)
    return ax


@styled
def policy_shares(result: Study | Portfolio) -> NDArray[Any]:
    """A panel per axis: at each of its values, the share of contexts that each policy serves.

    Dots are the mean performance of the contexts with that value. For three axes and more, or
    where contexts are no grid.

    Returns:
        (d,) axes.
    """
    space, routing = result.space, result.routing
    sources = routing.sources
    serving = np.asarray([sources[i] for i in routing.route])
    used = sorted(set(serving.tolist()))
    coloured = list(zip(used, colours(len(used)), strict=True))
    columns = max(1, 6 // (space.d + 1))
    rows = -(-len(coloured) // columns)
    figure = new_figure(min(3.0 * space.d + 1.5, 14.0), 3.2 + 0.17 * rows)
    panels = np.atleast_1d(figure.subplots(1, space.d))
    every = [
        _bars(panel, axis, space.values(axis.name), serving, coloured, routing.served)
        for axis, panel in zip(space.axes, panels, strict=True)
    ]
    from matplotlib.patches import Patch

    limits = np.array([dots.get_ylim() for dots in every])
    for dots in every:
        dots.set_ylim(min(0.0, limits.min()), max(1.0, limits.max()))
    figure.supylabel("share of contexts; dots, right: performance", fontsize=9)
    figure.suptitle(f"which policy serves; performance {_BY}", fontsize=9)
    figure.legend(
        handles=[Patch(color=c, label=space.describe(space.context(i))) for i, c in coloured],
        loc="outside lower center", ncols=columns,
    )  # fmt: skip
    return panels


# ---- inside --------------------------------------------------------------------------------------


def _pair(space: ContextSpace, over: tuple[str, str] | None) -> tuple[Axis, Axis]:
    by_name = {axis.name: axis for axis in space.axes}
    names = tuple(by_name)[:2] if over is None else over
    if len(set(names)) != 2 or not set(names) <= set(by_name):
        raise InvalidInput(f"a map needs two of the axes {list(by_name)}, got {names!r}")
    return by_name[names[0]], by_name[names[1]]


def _mesh(ax: Any, first: Axis, second: Axis, table: tuple[Array, Array, Array]) -> Any:
    across, up, means = table
    mesh = ax.pcolormesh(edges(first, across), edges(second, up), means)
    dress(ax, first, "x")
    dress(ax, second, "y")
    return mesh


def _mark(ax: Any, x: Array, y: Array, sources: Sequence[int]) -> None:
    """The number of every context trained on, those of one place together."""
    together: dict[tuple[float, float], list[str]] = {}
    for place, source in enumerate(sources, 1):
        together.setdefault((x[source], y[source]), []).append(str(place))
    box = {"boxstyle": "round,pad=0.18", "fc": "white", "ec": "black", "lw": 0.6, "alpha": 0.9}
    for (across, up), numbers in together.items():
        ax.text(across, up, ",".join(numbers), fontsize=7, ha="center", va="center", bbox=box)


def _bars(
    panel: Any,
    axis: Axis,
    values: Sequence[Value],
    serving: Array,
    coloured: list[tuple[int, Any]],
    performance: Array,
) -> Any:
    names, group = _groups(axis, values)
    counts, places = np.bincount(group), np.arange(len(names))
    below = np.zeros(len(names))
    for source, colour in coloured:
        share = np.bincount(group[serving == source], minlength=len(names)) / counts
        panel.bar(places, share, bottom=below, width=1.0, color=colour)
        below += share
    dots = panel.twinx()
    dots.plot(places, np.bincount(group, performance) / counts, "o", color="black", ms=3)
    panel.set_ylim(0.0, 1.0)
    panel.set_xlabel(axis.label)
    panel.set_xticks(places, names, rotation=90)
    return dots


def _groups(axis: Axis, values: Sequence[Value]) -> tuple[list[str], NDArray[np.intp]]:
    """Names of the bars of an axis, and the bar of each context: its values, or runs of them."""
    if isinstance(axis, Categorical):
        kinds = list(dict.fromkeys(values))
        return [str(kind) for kind in kinds], np.array([kinds.index(v) for v in values])
    levels, group = np.unique(np.asarray(values, dtype=float), return_inverse=True)
    runs = np.array_split(np.arange(len(levels)), min(len(levels), _MOST_BARS))
    bar = np.repeat(np.arange(len(runs)), [len(run) for run in runs])
    ends = [(levels[run[0]], levels[run[-1]]) for run in runs]
    names = [f"{low:.6g}" if low == high else f"{low:.4g} to {high:.4g}" for low, high in ends]
    return names, bar[group]
