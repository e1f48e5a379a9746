"""Pictures of a study, drawn from its summary; matplotlib only, no display needed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace
from mbtl.errors import cannot_write, missing_extra
from mbtl.report.reference import ReferenceCurves
from mbtl.report.summary import StudySummary
from mbtl.report.text import shown

_STYLE = {"axes.spines.top": False, "axes.spines.right": False, "font.size": 9}
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
        space: the contexts; on one numeric axis the map runs along it, else along the index.
        performance: (N,) performance of the serving policy on each context.
        path: file to write.
    """
    figure, axes = _figure(6.4, 3.2)
    line = space.d == 1 and space.unit.shape[1] == 1
    x = np.asarray(space.values(space.axes[0].name), dtype=float) if line else np.arange(space.n)
    serving = np.asarray(summary.serving)
    order = np.argsort(x)
    used = sorted(set(summary.serving))
    colours = _colours(len(used))
    for colour, source in zip(colours, used, strict=True):
        mine = serving == source
        axes.plot(x[mine], performance[mine], "s", ms=4, color=colour)
        axes.axvline(x[source], color=colour, lw=1, ls=":", zorder=0)
        axes.annotate(
            shown(space.context(source), space).split("= ")[-1],
            (x[source], 1.0), xycoords=("data", "axes fraction"), rotation=90,
            fontsize=7, color=colour, ha="center", va="bottom",
        )  # fmt: skip
    axes.plot(x[order], performance[order], lw=0.5, color=_GREY, zorder=0)
    axis = space.axes[0]
    axes.set_xlabel(
        f"{axis.name} [{axis.unit}]"
        if line and axis.unit
        else axis.name
        if line
        else "context index"
    )
    axes.set_ylabel("performance")
    return _save(figure, path)


def _band(axes: Any, curves: Array, label: str, colour: str) -> None:
    k = np.arange(1, curves.shape[1] + 1)
    axes.plot(k, curves.mean(axis=0), color=colour, lw=1, label=label)
    axes.fill_between(k, curves.min(axis=0), curves.max(axis=0), color=colour, alpha=0.2, lw=0)


def _figure(width: float, height: float) -> tuple[Any, Any]:
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise missing_extra("matplotlib", "plots") from error
    with rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        return figure, figure.add_subplot()


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
