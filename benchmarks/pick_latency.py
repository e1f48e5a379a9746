"""Time of one `mbtl` pick, and beside it what its peers need with the same observations.

A run of `mbtl` on a synthetic noisy matrix gives the histories. At picks 5 to 45 the selector
proposes again from the same history, and so do its peers, one after another on one thread:

  scikit-learn fit   the same selector with the paper's fit, 15 random restarts
  Optuna, BoTorch    one ask of a Bayesian optimiser over the same candidates (extra `rivals`)

Peers are slow, so they propose at every 4th pick (--peer-every); ratios are of means over those
picks.

example: python benchmarks/pick_latency.py --contexts 100 1000
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import measure
import numpy as np
from measure import Cost, Stopwatch, cost_of, digits, mean, median, note
from rivals import RIVALS, Rival
from sklearn_gp import fit_sklearn

from mbtl.arrays import Array
from mbtl.errors import MissingExtra
from mbtl.history import History
from mbtl.models import FittedGP, GPSettings, fit_gp
from mbtl.selectors import MBTL
from mbtl.zoo.benchmark import SyntheticWorld, linear_gap_world

FIRST, LAST = 5, 45
GOAL_MS = {100: 3.0, 1000: 5.0}
MS = 1e-3


def world(n: int) -> SyntheticWorld:
    """Training performance in waves, half a unit lost over the range, noise in every entry."""
    level = 0.75 + 0.2 * np.sin(3.0 * np.pi * np.arange(n) / n)
    return linear_gap_world(n, level=level, slope=0.5 / (n - 1), noise=0.02, n_seeds=1)


@dataclass(frozen=True)
class TimedGP(FittedGP):
    """A fitted process that charges its predictions."""

    watch: Stopwatch | None = None

    def predict(self, points: Array) -> tuple[Array, Array]:
        """As `FittedGP.predict`."""
        assert self.watch is not None
        with self.watch.of("predict"):
            return super().predict(points)


def timed_fit(points: Array, y: Array, settings: GPSettings, *, watch: Stopwatch) -> FittedGP:
    """As `fit_gp`, charged."""
    with watch.of("fit"):
        gp = fit_gp(points, y, settings)
    return TimedGP(
        gp.points, gp.y, gp.amplitude, gp.length, gp.noise_variance, gp.notes, gp.mean, watch
    )


class Picks:
    """One run on one world: its own costs at every measured pick, the peers' at some."""

    def __init__(self, n: int, repeats: int, peer_every: int) -> None:
        self.world, self.repeats, self.peer_every = world(n), repeats, peer_every
        self.problem = self.world.problem(LAST)
        self.own: dict[int, Cost] = {}
        self.parts: dict[str, list[Cost]] = {"fit": [], "predict": []}
        self.peers: dict[str, dict[int, Cost]] = {}
        self.notes: list[str] = []
        self.rivals = self._rivals() if peer_every else []

    def _rivals(self) -> list[Rival]:
        found: list[Rival] = []
        for rival in RIVALS:
            try:
                found.append(rival(self.problem.n))
            except MissingExtra as error:
                self.notes.append(str(error))
        return found

    def run(self) -> None:
        """Tell row after row; before each of the measured picks, everybody proposes."""
        history = History(self.problem.n)
        for k in range(1, LAST + 1):
            if k >= FIRST:
                self._measure(k, history)
            source = MBTL().propose(self.problem, history, np.random.default_rng(0)).source
            history = history.with_row(source, self.world.rows(0, [source])[0])
            for rival in self.rivals:
                rival.observe(source, float(history.training_performance[-1]))

    def _propose(self, selector: MBTL, history: History) -> Cost:
        fresh = History(history.n_targets, history.sources, history.rows)  # nothing cached yet
        rng = np.random.default_rng(0)
        return cost_of(lambda: selector.propose(self.problem, fresh, rng))

    def _measure(self, k: int, history: History) -> None:
        if k == FIRST:
            self._propose(MBTL(), history)  # the first call ever also loads code
        self.own[k] = median(self._propose(MBTL(), history) for _ in range(self.repeats))
        watches = [Stopwatch() for _ in range(self.repeats)]
        for watch in watches:
            self._propose(MBTL(fitter=partial(timed_fit, watch=watch)), history)
        for part, costs in self.parts.items():
            costs.append(median(watch.parts[part] for watch in watches))
        if not self.peer_every or (k - FIRST) % self.peer_every:
            return
        paper = MBTL(fitter=partial(fit_sklearn, restarts=15))
        if k == FIRST:
            self._propose(paper, history)
            for rival in self.rivals:
                rival.ask()
        asked = {"mbtl with scikit-learn's fit, 15 restarts": self._propose(paper, history)}
        asked |= {rival.name: cost_of(rival.ask) for rival in self.rivals}
        for name, cost in asked.items():
            self.peers.setdefault(name, {})[k] = cost

    def to_json(self) -> dict[str, Any]:
        """Means over the picks, in ms, and the ratio of each peer to `mbtl` at the same picks."""
        total = mean(self.own.values())
        parts = {name: mean(costs) for name, costs in self.parts.items()}
        parts["acquisition and the rest"] = total - parts["fit"] - parts["predict"]
        peers = {}
        for name, costs in self.peers.items():
            theirs, ours = mean(costs.values()), mean(self.own[k] for k in costs)
            ratio = {"ratio": digits(theirs.cpu / ours.cpu, 3), "picks": sorted(costs)}
            peers[name] = theirs.to_json(MS) | ratio
        return {
            "contexts": self.problem.n,
            "picks": [FIRST, LAST],
            "pick_ms": total.to_json(MS),
            "goal_ms": GOAL_MS.get(self.problem.n),
            "split_ms": {name: cost.to_json(MS) for name, cost in parts.items()},
            "peers_ms": peers,
            "notes": self.notes,
        }


def pick_lines(result: dict[str, Any]) -> list[str]:
    """One world as text."""
    pick, goal = result["pick_ms"], result["goal_ms"]
    lines = [
        f"N = {result['contexts']}: mean of picks {FIRST} to {LAST}, ms",
        f"  {'':46}{'clock':>10}{'cpu':>10}{'x mbtl':>9}",
        f"  {'mbtl':46}{pick['wall']:10.2f}{pick['cpu']:10.2f}{1:9.1f}"
        + ("" if goal is None else f"   goal {goal:g}"),
    ]
    for name, cost in result["split_ms"].items():
        lines.append(f"    {name:44}{cost['wall']:10.2f}{cost['cpu']:10.2f}")
    for name, cost in result["peers_ms"].items():
        lines.append(f"  {name:46}{cost['wall']:10.1f}{cost['cpu']:10.1f}{cost['ratio']:9.1f}")
    return [*lines, *result["notes"]]


def main() -> None:
    """Run what the arguments ask for."""
    parser = measure.parser(__doc__)
    parser.add_argument("--contexts", type=int, nargs="+", default=[100, 1000], help="values of N")
    parser.add_argument("--repeats", type=int, default=5, help="proposals per pick; the median")
    parser.add_argument("--peer-every", type=int, default=4, help="0: no peers at all")
    args = parser.parse_args()
    results, lines = [], []
    for n in args.contexts:
        note(f"N = {n} ...")
        picks = Picks(n, args.repeats, args.peer_every)
        picks.run()
        results.append(picks.to_json())
        lines += pick_lines(results[-1])
    machine = measure.machine("scikit-learn", "optuna", "botorch", "torch")
    measure.show({"results": results, "machine": machine}, lines, as_json=args.json)


if __name__ == "__main__":
    main()
