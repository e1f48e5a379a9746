"""Maps over the contexts: which policy serves each and how well, and what a model believed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import shorten
from typing import Any

import numpy as np

from mbtl.arrays import Array, Indices
from mbtl.contexts import Axis, Categorical, ContextSpace
from mbtl.errors import InvalidInput, StudyError
from mbtl.plot.style import GREY, axes_for, cells, distinct, dress, edges, number, positions, styled
from mbtl.portfolio import Portfolio
from mbtl.selectors.outlook import outlook
from mbtl.study import Study

_MOST_LINES = 24
_BY = "by the episodes that chose"


@styled
def policy_map(
    result: Study | Portfolio, *, over: tuple[str, str] | None = None, ax: Any = None
) -> Any:
    """Which policy serves which context, and how well.

    Policies have a colour each and are numbered in the order of their trainings. The legend says
    what each was trained on and how many contexts it serves; numbers stand at the contexts trained
    on.

    On one axis performance is drawn along it. On two it is a map; on a grid of more it is one at
    the middle values of the others. Contexts that are no grid are points of one map.

    Args:
        result: a study with rows, or a portfolio.
        over: names of the two axes of a map; None: those with the most values.
        ax: axes to draw on; None: new ones.

    Returns:
        The axes.

    Raises:
        InvalidInput: `over` are not two axes.
    """
    space, patches = result.space, _patches(result)
    if space.d == 1:
        return _along(result, patches, axes_for(ax, 6.8, 3.4))
    from matplotlib.colors import ListedColormap

    drawn, ax, routing = _pair(space, over), axes_for(ax, 6.8, 4.2), result.routing
    said, here = _middle(space, [axis for axis in space.axes if axis not in drawn])
    x, y = (positions(axis, space.values(axis.name)) for axis in drawn)
    rank = {policy: place for place, policy in enumerate(patches)}
    code = np.array([rank[i] for i in routing.route[here].tolist()], dtype=float)
    look: Any = {
        "cmap": ListedColormap([patch.get_facecolor() for patch in patches.values()]),
        "vmin": -0.5, "vmax": len(patches) - 0.5,
    }  # fmt: skip
    if space.shape is None:
        ax.scatter(x[here], y[here], c=code, marker="s", s=16, **look)
    else:  # one context in a cell
        across, up, table = cells(x[here], y[here], code)
        ax.pcolormesh(edges(drawn[0], across), edges(drawn[1], up), table, alpha=0.75, **look)
        served = cells(x[here], y[here], routing.served[here])[2]
        ordered = not any(isinstance(axis, Categorical) for axis in drawn)
        whole = ordered and len(here) == space.n and min(served.shape) > 1
        if whole and np.ptp(served) > 0:
            lines = ax.contour(across, up, served, 4, colors="black", linewidths=0.6, alpha=0.7)
            ax.clabel(lines, fontsize=6)
            said += f"; lines: performance {_BY}"
    for axis, side in zip(drawn, "xy", strict=True):
        dress(ax, axis, side)
    inside = set(here.tolist())
    _mark(ax, x, y, {p: source for p, source in _placed(result).items() if source in inside})
    ax.set_title(f"which policy serves{said}", fontsize=8)
    _legend(ax, patches)
    return ax


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


def _placed(result: Study | Portfolio) -> dict[int, int]:
    """Context of every policy that has one: those trained on several have no place."""
    if isinstance(result, Portfolio):
        several = set(result.sets)
    else:
        several = {i for i, row in enumerate(result.state.rows) if len(row.sources) > 1}
    return {i: source for i, source in enumerate(result.routing.sources) if i not in several}


def _legend(ax: Any, patches: Mapping[int, Any]) -> None:
    columns = -(-len(patches) // _MOST_LINES)
    words: Any = {"title": "policy: trained on (contexts it serves)", "alignment": "left"}
    place: Any = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
    ax.legend(handles=list(patches.values()), ncols=columns, **words, **place)


def _along(result: Study | Portfolio, patches: Mapping[int, Any], ax: Any) -> Any:
    """Performance along the only axis, coloured by policy."""
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
    places = {i: float(x[source]) for i, source in _placed(result).items()}
    number(ax, places, {i: p.get_facecolor() for i, p in patches.items()})
    _legend(ax, patches)
    return ax


def _middle(space: ContextSpace, others: Sequence[Axis]) -> tuple[str, Indices]:
    """The contexts at the middle values of other axes, and words for that; of a list all."""
    here, words = np.arange(space.n), list[str]()
    for axis in others if space.shape is not None else ():
        values = space.values(axis.name)
        levels = list(dict.fromkeys(values))
        middle = levels[len(levels) // 2]
        here = here[[values[i] == middle for i in here]]
        words.append(space.describe({axis.name: middle}))
    return f" at {', '.join(words)}" if words else "", here


# ---- inside --------------------------------------------------------------------------------------


def _pair(space: ContextSpace, over: tuple[str, str] | None) -> tuple[Axis, Axis]:
    by_name = {axis.name: axis for axis in space.axes}
    most = sorted(by_name, key=lambda name: -len(set(space.values(name))))[:2]
    names = tuple(name for name in by_name if name in most) if over is None else over
    if len(set(names)) != 2 or not set(names) <= set(by_name):
        raise InvalidInput(f"a map needs two of the axes {list(by_name)}, got {names!r}")
    return by_name[names[0]], by_name[names[1]]


def _mark(ax: Any, x: Array, y: Array, sources: Mapping[int, int]) -> None:
    """The number of every policy in a frame at its context, those of one place together."""
    together: dict[tuple[float, float], list[str]] = {}
    for policy, source in sources.items():
        together.setdefault((x[source], y[source]), []).append(str(policy + 1))
    box = {"boxstyle": "round,pad=0.18", "fc": "white", "ec": "black", "lw": 0.6, "alpha": 0.9}
    for (across, up), numbers in together.items():
        ax.text(across, up, ",".join(numbers), fontsize=7, ha="center", va="center", bbox=box)


# ---- what a selector's model believed ------------------------------------------------------------


BELIEVED = "training performance, believed"
_SURE = 1.96


@styled
def model(study: Study, step: int | None = None, *, ax: Any = None) -> Any:
    """What the model believed after `step` trainings, as the paper draws its Gaussian process.

    On one axis: mean and 95 % band of the training performance, the policies as dots, and along
    the bottom, on a scale of its own, the expected gain; a triangle is the pick that came next. On
    more axes: a map of the mean over the two with the most values, the others averaged. Selectors
    without a model are drawn with that of `specialists`.

    Args:
        study: with one or more rows.
        step: number of trainings; None: all.
        ax: axes to draw on; None: new ones.

    Raises:
        StudyError: nothing can be fitted to these rows.
    """
    history, space = study.history, study.space
    k = len(history) if step is None else step
    found = outlook(study.problem, history, study.spec.selector["name"], after=k)
    if found is None:
        n = sum(history.made(i).is_specialist for i in range(k))
        got = f"{n} that say nothing" if n else "none"
        raise StudyError(
            "a model needs rows to be fitted to, of specialists (whole trainings on one context, "
            f"from scratch), got {got} in {k} training{'s' * (k != 1)}; "
            "mbtl.plot.policy_map draws policies of every kind"
        )
    title = f"{found.model} after {k} training{'s' * (k != 1)}"
    taken, coming = history.sources[:k], history.sources[k : k + 1]
    ax, axis = axes_for(ax, height=3.6), space.axes[0]
    if space.d > 1:
        drawn = _pair(space, None)
        x, y = (positions(one, space.values(one.name)) for one in drawn)
        across, up, means = cells(x, y, found.mean)
        mesh = ax.pcolormesh(edges(drawn[0], across), edges(drawn[1], up), means)
        for one, side in zip(drawn, "xy", strict=True):
            dress(ax, one, side)
        ax.figure.colorbar(mesh, ax=ax, label=BELIEVED)
        _mark(ax, x, y, dict(enumerate(taken)))
        ax.set_title(title)
        return ax
    x = positions(axis, space.values(axis.name))
    order = np.argsort(x)
    low, high = found.mean - _SURE * found.std, found.mean + _SURE * found.std
    ax.fill_between(x[order], low[order], high[order], alpha=0.2, lw=0, label="95 % band")
    ax.plot(x[order], found.mean[order], label="believed")
    own = history.training_performance[:k]
    ax.plot(x[list(taken)], own, "o", ms=4, color="black", label="trained", zorder=4)
    dress(ax, axis)
    ax.set_ylabel(BELIEVED)
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
    number(ax, dict(enumerate(x[list(taken)])))
    ax.set_title(title, pad=24)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=4)
    return ax
