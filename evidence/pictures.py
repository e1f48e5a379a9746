"""The pictures of README and docs/concepts.md, from shipped transfer matrices; nothing is trained.

CartPole with 100 pole lengths, learnt by DQN: a policy of one length fails on others, so choosing
pays. The study is the one that the paper's rule makes of the matrix. README's picture is of all
transfer data: trainings of every kind, looked up.

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
from mbtl.plot.style import DARK, GREY, axes_for, dress, new_figure
from mbtl.strategies import Auto, get_strategy
from mbtl.zoo.benchmark import levels
from mbtl.zoo.benchmark.oracle import random_curve
from mbtl.zoo.benchmark.trainings import TransferWorld, replay_trainings, specialists_of
from mbtl.zoo.benchmark.transfers import load_transfers, transfer_ids

DOCS = Path(__file__).parents[1] / "docs"
NAME, SEED = "cartpole-length-dqn", 0
COMPARED = "pendulum-length-hidden"
UNITS = tuple(range(1, 16))
OURS, PAPER, EVERY = "auto, the default", "mbtl, the paper's rule", "all 20 or more specialists"
LOOKS = {
    OURS: ("#d55e00", "o"),
    "one policy for all, ever longer": ("#009e73", "s"),
    PAPER: ("#0072b2", "^"),
    "random specialists": (GREY, ""),
}
"""Colour and marker of each line of README's picture."""
SOURCES = (9, 30, 70)
"""Contexts whose policies are drawn one by one."""


def replayed(budget: int) -> mbtl.Study:
    """The study that the paper's rule makes when trainings are rows of the matrix."""
    matrix = mbtl.load_matrix(NAME)
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
    """V for so many units on all transfer data; and with three of them on each CMDP."""
    curves = {label: np.array(found) for label, found in replays().items()}  # (CMDP, budget)
    every = curves.pop(EVERY)
    with plot.style():
        left, right = new_figure(10.0, 3.6).subplots(1, 2)
        for label, (color, marker) in LOOKS.items():
            means = curves[label].mean(axis=0)
            bold = 2.2 if label == OURS else 1.3
            left.plot(UNITS, means, color=color, marker=marker, ms=3.5, lw=bold, label=label)
        left.axhline(every.mean(), color=GREY, ls=":", lw=1.0, label=EVERY)
        left.set_xlabel("units paid: trainings of one context's length")
        left.set_ylabel("performance on all contexts, V")
        left.set_title(f"mean of {len(every)} CMDPs, three seeds each")
        left.legend(loc="lower right", fontsize=7)

        names, at = [*reversed(transfer_ids())], np.arange(len(every))
        third = {label: found[::-1, UNITS.index(3)] for label, found in curves.items()}
        right.hlines(at, third[PAPER], third[OURS], color=GREY, lw=1.0)
        for label in (PAPER, OURS):
            color, marker = LOOKS[label]
            right.plot(third[label], at, marker, color=color, ms=6, ls="", label=label)
        right.plot(every[::-1], at, "|", color=DARK, ms=10, ls="", label=EVERY)
        right.set_yticks(at, names)
        right.set_xlabel("V with three units")
        right.set_title("each CMDP")
        right.legend(loc="upper left", fontsize=7)
    return left


def replays() -> dict[str, list[list[float]]]:
    """V of each CMDP at every budget, the mean over its seeds; trainings are looked up."""
    found: dict[str, list[list[float]]] = {label: [] for label in (*LOOKS, EVERY)}
    for name in transfer_ids():
        data, theta = load_transfers(name), mbtl.get_cmdp(name).theta
        matrix, seeds = specialists_of(data, theta), range(data.n_seeds)
        rules = {
            OURS: Auto().without(name.split("-")[0]),
            PAPER: get_strategy("mbtl"),
            "one policy for all, ever longer": get_strategy("one-policy"),
        }
        for label, rule in rules.items():
            worlds = [TransferWorld(data, seed, theta) for seed in seeds]
            runs = [replay_trainings(rule, world, UNITS[-1]) for world in worlds]
            found[label].append(np.mean([[run.at(b) for b in UNITS] for run in runs], 0).tolist())
        curves = [random_curve(matrix, seed, UNITS[-1]) for seed in seeds]
        found["random specialists"].append(np.mean(curves, axis=0).tolist())
        found[EVERY].append(np.mean([levels(matrix, seed).oracle_transfer for seed in seeds]))
    return found


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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="into docs/images")
    args = parser.parse_args()
    for name, draw in PICTURES.items():
        drawn = draw()
        if args.write:
            file = "hero" if name == "readme" else f"concepts-{name}"
            print(plot.save(drawn, DOCS / "images" / f"{file}.png"))


if __name__ == "__main__":
    main()
