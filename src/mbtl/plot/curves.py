"""V against the number of trainings: of a study beside baselines, or of several selectors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.plot.style import DARK, GREY, axes_for, styled
from mbtl.study import Study

V_LABEL = "generalisation performance V"
_DASHES = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (5, 1.5, 1.2, 1.5)))
_BLUE = "#0072B2"
_MARKS = "osD^vPX*"


@styled
def curve(
    study: Study | ArrayLike,
    *,
    baselines: Mapping[str, ArrayLike] | None = None,
    levels: Mapping[str, float] | None = None,
    label: str | None = None,
    ax: Any = None,
) -> Any:
    """V after each training of a study with its 95 % interval, beside named baselines.

    Across are units: a training that is longer stands further to the right.

    Args:
        study: whose running estimate of V is drawn; or (K,) values of V.
        baselines: name -> (K,) V of another method, or (S, K) of S seeds: mean, and all in a band.
        levels: name -> V of what needs no selection, drawn as a line across.
        label: of the curve; None: the study's selector and which episodes V is of.
        ax: axes to draw on; None: new ones.

    Returns:
        The axes.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    ax, margins = axes_for(ax), None
    if isinstance(study, Study):
        values, k = study.curve, study.state.units()
        said = f"{study.spec.selector['name']}, estimated"
        if study.state.rows and study.routing.noise_is_known:
            margins = np.array([now.margin for now in study.routing.curve])
        ax.set_title(f"{study.spec.problem or study.name}: {study.space.n} contexts")
    else:
        values, said = np.asarray(study, dtype=np.float64), "V"
        k = np.arange(1.0, len(values) + 1.0)
    for i, (name, level) in enumerate((levels or {}).items()):
        ax.axhline(level, color=GREY, lw=0.9, ls=_DASHES[3 - i % 2], label=name, zorder=1)
    for i, (name, rows) in enumerate((baselines or {}).items()):
        _seeds(ax, np.atleast_2d(np.asarray(rows, dtype=np.float64)), name, i)
    ax.plot(k, values, "o-", ms=4, color=_BLUE, label=label or said, zorder=4)
    if margins is not None:
        ax.errorbar(k, values, margins, fmt="none", ecolor=_BLUE, elinewidth=0.8, capsize=2)
    return _finish(ax)


@styled
def comparison(comparison: Any, matrix: str | None = None, *, ax: Any = None) -> Any:
    """V against k of every selector of a comparison on one matrix; bands span the matrix seeds.

    Args:
        comparison: what `mbtl.compare` gives.
        matrix: its name; None: the only one.
        ax: axes to draw on; None: new ones.

    Raises:
        InvalidInput: there are several matrices and none is named, or none of this name.
    """
    known = comparison.summary.matrices
    if matrix is None and len(known) == 1:
        matrix = next(iter(known))
    if matrix is None or matrix not in known:
        raise InvalidInput(
            f"matrix must be one of {sorted(known)}, got {matrix!r}; name one, as in "
            f"plot({min(known)!r})"
        )
    ax, one = axes_for(ax, height=3.6), known[matrix]
    names = [name for name in one.selectors if name not in ("random", "oracle")]
    _seeds(ax, one.random[None], "Random", 0)
    _seeds(ax, one.oracle[None], "Sequential Oracle", 1)
    for i, name in enumerate(names):
        runs = [r for r in comparison.results if (r.matrix, r.selector) == (matrix, name)]
        seeds = sorted({run.matrix_seed for run in runs})
        rows = np.array(
            [np.mean([r.performance for r in runs if r.matrix_seed == s], axis=0) for s in seeds]
        )
        k = np.arange(1, rows.shape[1] + 1)
        style = {"ls": _DASHES[i // 8 % 4], "marker": _MARKS[i % 8], "ms": 3.5, "zorder": 3}
        (line,) = ax.plot(k, rows.mean(axis=0), label=name, **style)
        if len(rows) > 1:
            colour = line.get_color()
            ax.fill_between(k, rows.min(0), rows.max(0), color=colour, alpha=0.12, lw=0)
    for name, level in (("Independent", one.independent), ("Oracle Transfer", one.oracle_transfer)):
        ax.axhline(level, color=GREY, lw=0.9, ls=_DASHES[2 - (name == "Independent")], label=name)
    ax.set_title(f"{matrix}: {one.n_seeds} seed{'s' * (one.n_seeds > 1)}")
    return _finish(ax)


def _seeds(ax: Any, rows: Array, name: str, number: int) -> None:
    """Mean over seeds, thin and without marks, in a band of all of them."""
    k, colour = np.arange(1, rows.shape[1] + 1), [GREY, DARK, "#D55E00", "#009E73"][number % 4]
    ax.plot(k, rows.mean(axis=0), color=colour, lw=1.1, ls=_DASHES[(number + 1) % 4], label=name)
    if len(rows) > 1:
        ax.fill_between(k, rows.min(axis=0), rows.max(axis=0), color=colour, alpha=0.15, lw=0)


def _finish(ax: Any) -> Any:
    ax.set_xlabel("units: whole trainings on one context")
    ax.set_ylabel(V_LABEL)
    ax.xaxis.get_major_locator().set_params(integer=True)
    ax.legend(loc="best", ncols=1 if len(ax.get_lines()) < 7 else 2)
    return ax
