"""Pictures of a study, drawn from its summary; matplotlib only, no display needed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.contexts import Axis, Categorical, ContextSpace, Value
from mbtl.errors import cannot_write, missing_extra
from mbtl.report.reference import ReferenceCurves
from mbtl.report.summary import StudySummary

_STYLE = {"axes.spines.top": False, "axes.spines.right": False, "font.size": 9}
_MOST_BARS = 12
_BLUE, _GREY = "#1f5fa8", "#777777"


def plot_curve(summary: StudySummary, path: Path, reference: ReferenceCurves | None = None) -> Path:
    """V against the number of trainings, fresh episodes where measured; PNG.

    Raises:
        MissingExtra: matplotlib is not installed.
        StorageError: `path` cannot be written.
    """
    figure, axes = _figure(5.2, 3.2)
    told = summary.told
    k = np.arange(1, len(told) + 1)
    values = [pick.fresh_value for pick in told]
    measured = all(v is not None for v in values)
    label = (
        f"{summary.selector}, fresh episodes"
        if measured
        else f"{summary.selector}, selecting episodes"
    )
    axes.plot(
        k, values if measured else [p.value for p in told], "o-", color=_BLUE, label=label, ms=4
    )
    if reference is not None:
        _band(axes, reference.random, "Random", "#bbbbbb")
        _band(axes, reference.oracle, "Sequential Oracle", "#333333")
        if len(reference.greedy):
            _band(axes, reference.greedy, "Greedy", "#d9822b")
    axes.set_xlabel("trainings k")
    axes.set_ylabel("generalisation performance V")
    axes.set_title(f"{summary.problem}: {summary.n_contexts} contexts", loc="left")
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.legend(frameon=False, loc="lower right")
    return _save(figure, path)


def plot_policy_map(
    summary: StudySummary, space: ContextSpace, performance: Array, path: Path
) -> Path:
    """Which policy serves which context, and how well; PNG.

    Args:
        summary: of the study.
        space: the contexts. On one numeric axis the map runs along it; else there is a panel per
            axis: at each of its values, the share of contexts that each policy serves.
        performance: (N,) performance of the serving policy on each context.
        path: file to write.
    """
    draw = _line_map if space.d == 1 and space.unit.shape[1] == 1 else _shares_map
    return _save(draw(space, np.asarray(summary.serving), performance), path)


def _line_map(space: ContextSpace, serving: Array, performance: Array) -> Any:
    figure, axes = _figure(6.4, 3.2)
    axis = space.axes[0]
    x = np.asarray(space.values(axis.name), dtype=float)
    order = np.argsort(x)
    for source, colour in _coloured(serving):
        mine = serving == source
        axes.plot(x[mine], performance[mine], "s", ms=4, color=colour)
        axes.axvline(x[source], color=colour, lw=1, ls=":", zorder=0)
        axes.annotate(
            f"{x[source]:.6g} {axis.unit}".rstrip(),
            (x[source], 1.0), xycoords=("data", "axes fraction"), rotation=90,
            fontsize=7, color=colour, ha="center", va="bottom",
        )  # fmt: skip
    axes.plot(x[order], performance[order], lw=0.5, color=_GREY, zorder=0)
    axes.set_xlabel(axis.label)
    axes.set_ylabel("performance")
    return figure


def _shares_map(space: ContextSpace, serving: Array, performance: Array) -> Any:
    """A panel per axis; dots are the mean performance of the contexts with that value."""
    from matplotlib.patches import Patch

    coloured = _coloured(serving)
    columns = max(1, 4 - space.d // 2)
    rows = -(-len(coloured) // columns)
    figure, panels = _figure(min(3.0 * space.d + 1.5, 14.0), 3.2 + 0.17 * rows, space.d)
    every = []
    for axis, panel in zip(space.axes, np.atleast_1d(panels), strict=True):
        names, group = _groups(axis, space.values(axis.name))
        counts, places = np.bincount(group), np.arange(len(names))
        below = np.zeros(len(names))
        for source, colour in coloured:
            share = np.bincount(group[serving == source], minlength=len(names)) / counts
            panel.bar(places, share, bottom=below, width=1.0, color=colour)
            below += share
        dots = panel.twinx()
        dots.plot(places, np.bincount(group, performance) / counts, "o", color="black", ms=3)
        every.append(dots)
        panel.set_ylim(0.0, 1.0)
        panel.set_xlabel(axis.label)
        panel.set_xticks(places, names, rotation=90)
    limits = np.array([dots.get_ylim() for dots in every])
    for dots in every:
        dots.set_ylim(min(0.0, limits.min()), max(1.0, limits.max()))
    figure.supylabel("share of contexts; dots, right: performance", fontsize=9)
    figure.legend(
        handles=[Patch(color=c, label=space.describe(space.context(i))) for i, c in coloured],
        loc="outside lower center", ncols=columns, frameon=False, fontsize=7,
    )  # fmt: skip
    return figure


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


def _coloured(serving: Array) -> list[tuple[int, Any]]:
    """Sources that serve a context, with their colours."""
    used = sorted({int(source) for source in serving})
    return list(zip(used, _colours(len(used)), strict=True))


def _band(axes: Any, curves: Array, label: str, colour: str) -> None:
    k = np.arange(1, curves.shape[1] + 1)
    axes.plot(k, curves.mean(axis=0), color=colour, lw=1, label=label)
    axes.fill_between(k, curves.min(axis=0), curves.max(axis=0), color=colour, alpha=0.2, lw=0)


def _figure(width: float, height: float, panels: int = 1) -> tuple[Any, Any]:
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise missing_extra("matplotlib", "plots") from error
    with rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        return figure, figure.subplots(1, panels)


def _colours(n: int) -> list[Any]:
    from matplotlib import colormaps

    return [colormaps["turbo"](0.08 + 0.84 * i / max(n - 1, 1)) for i in range(n)]


def _save(figure: Any, path: Path) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150)
    except OSError as error:
        raise cannot_write(path, error) from error
    return path
