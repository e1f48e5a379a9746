"""The model of a selector after some trainings: mean, band, and the gain it expects."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from mbtl.errors import StudyError
from mbtl.plot.maps import heatmap
from mbtl.plot.style import axes_for, dress, number, positions, styled
from mbtl.selectors.outlook import outlook
from mbtl.study import Study

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
