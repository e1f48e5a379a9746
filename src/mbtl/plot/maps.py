"""Maps over the contexts: a value per context, or which policy serves it and how well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import shorten
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbtl.arrays import Array
from mbtl.contexts import Axis, Categorical, ContextSpace, Value
from mbtl.errors import InvalidInput, StudyError
from mbtl.plot.style import (
    GREY,
    axes_for,
    cells,
    distinct,
    dress,
    edges,
    new_figure,
    number,
    positions,
    styled,
)
from mbtl.portfolio import Portfolio
from mbtl.selectors.outlook import outlook
from mbtl.study import Study

_MOST_MAPS, _MOST_LINES = 9, 24
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
        over: names of the two axes of the map; None: those with the most values. Others are
            averaged.
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
    _mark(ax, x, y, dict(enumerate(sources)))
    return ax


@styled
def policy_map(
    result: Study | Portfolio, *, over: tuple[str, str] | None = None, ax: Any = None
) -> Any:
    """Which policy serves which context, and how well.

    Policies have a colour each and are numbered in the order of their trainings. The number of a
    policy stands where it serves, and the legend says what it was trained on and how many contexts
    it serves; numbers in frames stand at the contexts trained on.

    On one axis performance is drawn along it. On two it is a map. On three to five there is a map
    for each value of the other axes: at most nine maps, whose values are evenly spread where there
    are more; for ranges of values where contexts are no grid. On six and more it is one map, at the
    middle values of the others.

    Args:
        result: a study with rows, or a portfolio.
        over: names of the two axes of a map; None: those with the most values.
        ax: axes to draw on, of one map; None: new ones.

    Returns:
        The axes; (m,) where there are several maps.

    Raises:
        InvalidInput: `over` are not two axes, or `ax` is one for several maps.
    """
    space, patches = result.space, _patches(result)
    if space.d == 1:
        return _along(result, patches, axes_for(ax, 6.8, 3.4))
    first, second = _pair(space, over)
    others = [axis for axis in space.axes if axis not in (first, second)]
    facets = _facets(space, others)
    if len(facets) == 1:
        one, (where, here) = axes_for(ax, 6.8, 4.2), facets[0]
        lined = _territory(result, patches, one, (first, second), here)
        said = f"; lines: performance {_BY}" if lined else ""
        where = f" at {where}" if len(here) < space.n else ""
        one.set_title(f"which policy serves{where}{said}", fontsize=8)
        _legend(one, patches, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return one
    if ax is not None:
        raise InvalidInput(
            f"policies on {space.d} axes are {len(facets)} maps, got axes for one; leave ax out"
        )
    columns = min(len(facets), 3)
    rows = -(-len(facets) // columns)
    figure = new_figure(0.8 + 2.6 * columns, 0.8 + 2.4 * rows + 0.17 * len(patches))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for panel in panels[len(facets) :]:
        panel.set_axis_off()
    for panel, (title, here) in zip(panels, facets, strict=False):
        _territory(result, patches, panel, (first, second), here)
        panel.label_outer()
        panel.set_title(title, fontsize=8)
    shown = sum(len(here) for _, here in facets)
    part = f" ({shown} of {space.n} contexts)" if shown < space.n else ""
    figure.suptitle(f"which policy serves{part}", fontsize=9)
    _legend(figure, patches, loc="outside lower center")
    return panels[: len(facets)]


# ---- who serves ----------------------------------------------------------------------------------


def _patches(result: Study | Portfolio) -> dict[int, Any]:
    """Colour and words of every policy that serves, by its position."""
    from matplotlib.patches import Patch

    routing = result.routing
    counts = np.bincount(routing.route)
    used = np.flatnonzero(counts)

    def words(i: int) -> str:
        if isinstance(result, Portfolio):
            where = result.trained_on(i)
        else:
            where = result.state.said(result.state.rows[i])
        return f"{i + 1}: {shorten(where, 60)} ({counts[i]})"

    pairs = zip(used.tolist(), distinct(len(used)), strict=True)
    return {i: Patch(color=colour, label=words(i)) for i, colour in pairs}


def _legend(owner: Any, patches: Mapping[int, Any], **place: Any) -> None:
    columns = -(-len(patches) // _MOST_LINES)
    words: Any = {"title": "policy: trained on (contexts it serves)", "alignment": "left"}
    owner.legend(handles=list(patches.values()), ncols=columns, **words, **place)


def _along(result: Study | Portfolio, patches: Mapping[int, Any], ax: Any) -> Any:
    """Performance along the only axis, coloured by policy, each named at its longest stretch."""
    (axis,), routing = result.space.axes, result.routing
    x = positions(axis, result.space.values(axis.name))
    order = np.argsort(x, kind="stable")
    if not isinstance(axis, Categorical):
        ax.plot(x[order], routing.served[order], lw=0.6, color=GREY, zorder=1)
    for i, patch in patches.items():
        mine = routing.route == i
        ax.plot(x[mine], routing.served[mine], "s", ms=3.5, color=patch.get_facecolor(), zorder=2)
    dress(ax, axis)
    ax.set_ylabel(f"performance {_BY}")
    number(ax, x[list(routing.sources)], {i: p.get_facecolor() for i, p in patches.items()})
    along = routing.route[order]
    stretches = np.split(order, np.flatnonzero(np.diff(along)) + 1)
    for i in patches:
        mine = max((one for one in stretches if routing.route[one[0]] == i), key=len)
        middle = mine[len(mine) // 2]
        _name(ax, i, x[middle], routing.served[middle], xytext=(0, -9))
    _legend(ax, patches, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax


def _territory(
    result: Study | Portfolio,
    patches: Mapping[int, Any],
    ax: Any,
    drawn: tuple[Axis, Axis],
    here: NDArray[np.intp],
) -> bool:
    """Some contexts over two axes, coloured and named by policy; whether there are lines of V."""
    from matplotlib.colors import ListedColormap

    space, routing = result.space, result.routing
    x, y = (positions(axis, space.values(axis.name)) for axis in drawn)
    rank = {policy: place for place, policy in enumerate(patches)}
    code = np.array([rank[i] for i in routing.route[here].tolist()], dtype=float)
    look: Any = {
        "cmap": ListedColormap([patch.get_facecolor() for patch in patches.values()]),
        "vmin": -0.5, "vmax": len(patches) - 0.5,
    }  # fmt: skip
    lined = False
    above = (0, 8) if space.shape is None else (0, 0)
    if space.shape is None:
        ax.scatter(x[here], y[here], c=code, marker="s", s=16, **look)
    else:  # one context in a cell
        across, up, table, _ = cells(x[here], y[here], code)
        ax.pcolormesh(edges(drawn[0], across), edges(drawn[1], up), table, alpha=0.75, **look)
        served = cells(x[here], y[here], routing.served[here])[2]
        ordered = not any(isinstance(axis, Categorical) for axis in drawn)
        whole = ordered and len(here) == space.n and min(served.shape) > 1
        lined = bool(whole and np.ptp(served) > 0)
        if lined:
            lines = ax.contour(across, up, served, 4, colors="black", linewidths=0.6, alpha=0.7)
            ax.clabel(lines, fontsize=6)
    for axis, side in zip(drawn, "xy", strict=True):
        dress(ax, axis, side)
    inside = set(here.tolist())
    trained = {p: source for p, source in enumerate(routing.sources) if source in inside}
    _mark(ax, x, y, trained)
    places = np.column_stack([np.unique(v, return_inverse=True)[1] for v in (x, y)])
    for i in np.unique(routing.route[here]).tolist():
        mine = here[routing.route[here] == i]
        if trained.get(i) not in mine:
            away = np.linalg.norm(places[mine] - places[mine].mean(axis=0), axis=1)
            _name(ax, i, x[mine[away.argmin()]], y[mine[away.argmin()]], xytext=above)
    return lined


def _name(ax: Any, policy: int, x: float, y: float, xytext: tuple[int, int] = (0, 0)) -> None:
    """The number of a policy where it serves."""
    from matplotlib.patheffects import withStroke

    ax.annotate(
        str(policy + 1), (x, y), xytext=xytext, textcoords="offset points", fontsize=8,
        weight="bold", ha="center", va="center", gid="serves",
        path_effects=[withStroke(linewidth=1.8, foreground="white")],
    )  # fmt: skip


def _facets(space: ContextSpace, others: Sequence[Axis]) -> list[tuple[str, NDArray[np.intp]]]:
    """Contexts by the values of the axes that a map does not show, with words for them."""
    facets = [("", np.ones(space.n, dtype=bool))]
    for axis in others:
        most = int(_MOST_MAPS ** (1.0 / len(others)))
        names, group = _groups(axis, space.values(axis.name), most, runs=space.shape is None)
        last = len(names) - 1
        some = (
            np.unique(np.linspace(0, last, most).round().astype(int)) if most > 1 else [last // 2]
        )
        facets = [
            (f"{words}, {axis.name} {names[k]}".removeprefix(", "), mask & (group == k))
            for words, mask in facets
            for k in some
        ]
    return [(words, np.flatnonzero(mask)) for words, mask in facets if mask.any()]


# ---- inside --------------------------------------------------------------------------------------


def _pair(space: ContextSpace, over: tuple[str, str] | None) -> tuple[Axis, Axis]:
    by_name = {axis.name: axis for axis in space.axes}
    most = sorted(by_name, key=lambda name: -len(set(space.values(name))))[:2]
    names = tuple(name for name in by_name if name in most) if over is None else over
    if len(set(names)) != 2 or not set(names) <= set(by_name):
        raise InvalidInput(f"a map needs two of the axes {list(by_name)}, got {names!r}")
    return by_name[names[0]], by_name[names[1]]


def _mesh(ax: Any, first: Axis, second: Axis, table: tuple[Array, Array, Array]) -> Any:
    across, up, means = table
    mesh = ax.pcolormesh(edges(first, across), edges(second, up), means)
    dress(ax, first, "x")
    dress(ax, second, "y")
    return mesh


def _mark(ax: Any, x: Array, y: Array, sources: Mapping[int, int]) -> None:
    """The number of every policy in a frame at its context, those of one place together."""
    together: dict[tuple[float, float], list[str]] = {}
    for policy, source in sources.items():
        together.setdefault((x[source], y[source]), []).append(str(policy + 1))
    box = {"boxstyle": "round,pad=0.18", "fc": "white", "ec": "black", "lw": 0.6, "alpha": 0.9}
    for (across, up), numbers in together.items():
        ax.text(across, up, ",".join(numbers), fontsize=7, ha="center", va="center", bbox=box)


def _groups(
    axis: Axis, values: Sequence[Value], most: int, *, runs: bool
) -> tuple[list[str], NDArray[np.intp]]:
    """Names of an axis's values, or of at most so many runs of them, and which each context has."""
    if isinstance(axis, Categorical):
        kinds = list(dict.fromkeys(values))
        return [str(kind) for kind in kinds], np.array([kinds.index(v) for v in values])
    levels, group = np.unique(np.asarray(values, dtype=float), return_inverse=True)
    parts = np.array_split(np.arange(len(levels)), min(len(levels), most) if runs else len(levels))
    bar = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    ends = [(levels[part[0]], levels[part[-1]]) for part in parts]
    names = [f"{low:.6g}" if low == high else f"{low:.4g} to {high:.4g}" for low, high in ends]
    return names, bar[group]


# ---- what a selector's model believed ------------------------------------------------------------


Quantity = Literal["mean", "std", "gain"]
LABELS = {
    "mean": "training performance, believed",
    "std": "standard deviation of that",
    "gain": "expected gain in V",
}
_SURE = 1.96


@styled
def model(study: Study, step: int | None = None, *, show: Quantity = "mean", ax: Any = None) -> Any:
    """What the model believed after `step` trainings, as the paper draws its Gaussian process.

    On one axis: mean and 95 % band of the training performance, the policies as dots, and along
    the bottom, on a scale of its own, the expected gain; a triangle is the pick that came next. On
    two axes: a map of `show`. Selectors without a model are drawn with that of `specialists`.

    Args:
        study: with one or more rows.
        step: number of trainings; None: all.
        show: what a map shows.
        ax: axes to draw on; None: new ones.

    Raises:
        StudyError: nothing can be fitted to these rows.
    """
    history, space = study.history, study.space
    k = len(history) if step is None else step
    found = outlook(study.problem, history, study.spec.selector["name"], after=k)
    if found is None:
        raise StudyError(f"a model needs rows to be fitted to, got {k} that say nothing")
    title = f"{found.model} after {k} training{'s' * (k != 1)}"
    taken, coming = history.sources[:k], history.sources[k : k + 1]
    if space.d > 1:
        ax = heatmap(space, getattr(found, show), label=LABELS[show], sources=taken, ax=ax)
        ax.set_title(title)
        return ax
    ax, axis = axes_for(ax, height=3.6), space.axes[0]
    x = positions(axis, space.values(axis.name))
    order = np.argsort(x)
    low, high = found.mean - _SURE * found.std, found.mean + _SURE * found.std
    ax.fill_between(x[order], low[order], high[order], alpha=0.2, lw=0, label="95 % band")
    ax.plot(x[order], found.mean[order], label="believed")
    own = history.training_performance[:k]
    ax.plot(x[list(taken)], own, "o", ms=4, color="black", label="trained", zorder=4)
    dress(ax, axis)
    ax.set_ylabel(LABELS["mean"])
    below = ax.twinx()
    gain = np.maximum(found.gain[order], 0.0)
    asked = np.isfinite(gain)
    below.fill_between(x[order][asked], gain[asked], color="#E69F00", alpha=0.6, lw=0)
    below.set_ylim(0.0, 3.5 * max(float(gain[asked].max(initial=0.0)), 1e-9))
    below.spines.right.set_visible(True)
    below.set_ylabel("expected gain in V (orange)")
    for source in coming:
        below.plot(x[source], 0.0, "^", ms=7, color="#D55E00", clip_on=False, zorder=5)
        ax.plot([], [], "^", ms=7, color="#D55E00", label="next pick")
    number(ax, x[list(taken)])
    ax.set_title(title, pad=24)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=4)
    return ax
