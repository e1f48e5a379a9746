"""The pictures of README and docs/concepts.md, from shipped transfer matrices; nothing is trained.

CartPole with 100 pole lengths, learnt by DQN: a policy of one length fails on others, so choosing
pays. The study is the one that the paper's rule makes of the matrix. README's picture is of a merge
onto a motorway, where advice is held for 1 to 40 s.

example: python evidence/pictures.py --write
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import mbtl
from mbtl import plot
from mbtl.plot.style import axes_for, dress, new_figure

DOCS = Path(__file__).parents[1] / "docs"
NAME, SEED = "cartpole-length-dqn", 0
COMPARED = "pendulum-length-hidden"
README = "ramp-acc"
SOURCES = (9, 30, 70)
"""Contexts whose policies are drawn one by one."""


def replayed(budget: int, name: str = NAME) -> mbtl.Study:
    """The study that the paper's rule makes when trainings are rows of the matrix."""
    matrix = mbtl.load_matrix(name)
    study = mbtl.create_study(
        matrix.space, budget=budget, strategy="mbtl", objective=mbtl.Objective(matrix.bounds)
    )
    for _ in range(budget):
        pick = study.ask()
        study.tell(pick, matrix.returns[SEED, pick.source])
    return study


def rows(ax: Any = None) -> Any:
    """Three policies on all contexts, and the best of the three on each."""
    with plot.style():
        ax = axes_for(ax)
        matrix = mbtl.load_matrix(NAME)
        axis, x = matrix.axes[0], np.array(matrix.space.values("length"))
        shown = matrix.rows(SEED, SOURCES)
        ax.fill_between(x, shown.max(axis=0), color="#999999", alpha=0.25, lw=0, label="the best")
        for source, row in zip(SOURCES, shown, strict=True):
            (line,) = ax.plot(x, row, lw=1.4, label=f"trained at {x[source]:g} m")
            ax.plot(x[source], row[source], "o", ms=6, color=line.get_color())
        dress(ax, axis)
        ax.set_ylabel("performance")
        ax.set_ylim(0.0, 1.05)
        ax.set_title(f"V = {shown.max(axis=0).mean():.2f}, the mean height of the grey area")
        ax.legend(loc="center right")
    return ax


def gap(ax: Any = None) -> Any:
    """What is lost away from the source, and the straight line that the paper assumes."""
    with plot.style():
        ax = axes_for(ax)
        matrix, source = mbtl.load_matrix(NAME), SOURCES[1]
        steps = np.abs(np.arange(matrix.n) - source)
        row = matrix.rows(SEED, [source])[0]
        ax.plot(matrix.space.values("length"), row[source] - row, label="loss that was measured")
        line = matrix.theta * steps
        x = matrix.space.values("length")
        ax.plot(x, line, "--", color="#D55E00", label=f"{matrix.theta:g} per grid step")
        dress(ax, matrix.axes[0])
        ax.set_ylabel("performance lost")
        ax.set_title(f"the policy trained at {x[source]:g} m")
        ax.legend(loc="center right")
    return ax


def compared(ax: Any = None) -> Any:
    """Selectors side by side."""
    names = ["random", "greedy", "mbtl", "specialists", "oracle"]
    return mbtl.compare(names, [mbtl.load_matrix(COMPARED)], 15, seeds=1).plot(ax=ax)


def readme() -> Any:
    """V against the number of trainings, and which policy serves which context."""
    with plot.style():
        left, right = new_figure(10.6, 3.6).subplots(1, 2)
        matrix = mbtl.load_matrix(README)
        mbtl.compare(
            ["random", "greedy", "specialists", "mbtl", "oracle"], [matrix], 15, seeds=1
        ).plot(ax=left)
        left.set_title(f"{README}: {matrix.n} contexts, {matrix.n_seeds} seeds")
        left.legend(loc="lower right", fontsize=7)
        plot.policy_map(replayed(15, README), ax=right)
    return left


PICTURES: dict[str, Callable[[], Any]] = {
    "matrix": lambda: plot.matrix(mbtl.load_matrix(NAME), SEED, picks=SOURCES),
    "rows": rows,
    "gap": gap,
    "model": lambda: plot.model(replayed(5), 4),
    "policy-map": lambda: plot.policy_map(replayed(5)),
    "comparison": compared,
    "readme": readme,
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true", help="into docs/images")
    args = parser.parse_args()
    for name, draw in PICTURES.items():
        drawn = draw()
        if args.write:
            file = "hero" if name == "readme" else f"concepts-{name}"
            print(plot.save(drawn, DOCS / "images" / f"{file}.png"))


if __name__ == "__main__":
    main()
