"""Processor seconds and memory of every selector's picks on grids of 100 to 10,000 contexts.

    .venv/bin/python benchmarks/selector_latency.py [--picks 15] [--selectors mbtl] [--grids 100]

Grids: 100 on a line, 10 x 10 x 9 (the follow-up's CartPole), 100 x 100, with a synthetic world of
directional decay. "Last pick" is the median of the last six. Published for comparison (SD-MBTL, its
authors' processor seconds for 15 picks): GP-MBTL 10.9 s and M-MBTL 5.7 s at N = 512, GP-MBTL 9.7 s
and M-MBTL 14.6 s at N = 900.
"""

from __future__ import annotations

import measure  # first: threads

import argparse  # isort: skip

import numpy as np

from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.objective import Bounds
from mbtl.selectors import get_selector
from mbtl.zoo.benchmark.synthetic import SyntheticWorld

GRIDS = "100,10x10x9,100x100"
SELECTORS = "greedy,mbtl,mbtl-release,mbtl-ei,gp-mbtl,m-mbtl,sd-mbtl,specialists"


def world(shape: tuple[int, ...]) -> SyntheticWorld:
    """Return falls by up to half per axis, three times as fast above the target as below it."""
    d = len(shape)
    slope = [0.5 / d / (levels - 1) for levels in shape]
    return SyntheticWorld(
        "latency", shape, quality=1.0, difficulty=0.0, left=tuple(-s / 3 for s in slope),
        right=tuple(slope), noise=0.02, scale=Bounds(0.0, 1.0),
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--picks", type=int, default=15)
    parser.add_argument("--selectors", default=SELECTORS)
    parser.add_argument("--grids", default=GRIDS)
    args = parser.parse_args()
    heads = ("all picks", "last pick")
    print(f"{'selector':14s}{'N':>8s}" + "".join(f"{h:>12s}" for h in heads) + f"{'peak MiB':>10s}")
    for grid in args.grids.split(","):
        source = world(tuple(map(int, grid.split("x"))))
        problem = source.problem(args.picks)
        for name in args.selectors.split(","):
            selector, history, spent = get_selector(name), History(problem.n), []
            try:
                for k in range(args.picks):
                    begin = measure.now()
                    pick = selector.propose(problem, history, np.random.default_rng(k)).source
                    spent.append((measure.now() - begin).cpu)
                    history = history.with_row(pick, source.rows(0, [pick])[0])
            except InvalidInput:  # greedy needs one axis
                continue
            seconds = (sum(spent), float(np.median(spent[-6:])))
            cells = "".join(f"{value:10.3f} s" for value in seconds)
            print(f"{name:14s}{problem.n:8,d}{cells}{1024 * measure.peak_gib():10.0f}")


if __name__ == "__main__":
    main()
