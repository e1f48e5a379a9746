"""What each device of `auto` is worth: every one switched off alone, the same runs otherwise.

    .venv/bin/python evidence/auto_ablation.py [--set shipped] [--variants "no cover,no floor"]

Sets: the shipped matrices of one axis, `auto` with the prior that has not seen their family; the
shipped ones of several axes; SD-MBTL's eight worlds (N = 512, K = 50); our seven worlds of several
axes, every seed of each. What is compared, pair by pair on the same runs:

  at K, curve   closed fraction, sum(V - Random) / sum(oracle - Random), at K and under the curve;
                its change against `auto`, and 95 % intervals by drawing runs again
  trainings     to 90, 95 and 99 % of the way to Oracle Transfer: change of their geometric mean in
                per cent with one standard error, K + 1 where a level is not reached; less is better
"""

from __future__ import annotations

import measure  # first: threads

import time  # isort: skip
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any
from unittest import mock

import numpy as np
from measure import digits, note
from sd_worlds import sd_worlds
from several_axes import worlds

from mbtl.acquisition import RowGain
from mbtl.acquisition.gain import unit_improvement
from mbtl.arrays import Array
from mbtl.models.linear_trend import LinearTrend, fit_linear_trend
from mbtl.selectors import Auto
from mbtl.zoo.benchmark import levels, random_curve, sequential_oracle
from mbtl.zoo.benchmark.base import RowSource, measured_curve
from mbtl.zoo.benchmark.compare import held_out
from mbtl.zoo.benchmark.comparison import trainings_to
from mbtl.zoo.benchmark.replay import replay
from mbtl.zoo.benchmark.shipped import load_by_id, open_matrices, shipped_matrices

DRAWS = 2000
MARGIN = 0.02
WHOLE = "auto"


@dataclass(frozen=True)
class Variant:
    """`auto` with other settings, and other constants of its modules."""

    settings: Mapping[str, Any]
    constants: Mapping[str, Any]

    @contextmanager
    def applied(self) -> Iterator[Auto]:
        """The selector, while the constants hold."""
        patches = [mock.patch(name, value) for name, value in self.constants.items()]
        for patch in patches:
            patch.start()
        try:
            yield replace(Auto(), **self.settings)
        finally:
            for patch in patches:
                patch.stop()


@dataclass(frozen=True)
class OneCeiling(RowGain):
    """Nobody does better than a little above the best performance seen anywhere: no ceilings."""

    def by_target(self, candidates: Array) -> Array:
        """As it was."""
        mean, std = self.model.predict(candidates, self.targets)
        gain = unit_improvement((mean - self.best) / std)
        return np.asarray(std * (gain - unit_improvement((mean - self._highest) / std)))

    @cached_property
    def _highest(self) -> Array:
        margin = MARGIN * float(np.ptp(self.model.y))
        return np.maximum(self.seen + margin, self.best)


def never(*data: Any) -> LinearTrend:
    """The trend, unlikelier than anything."""
    return replace(fit_linear_trend(*data), log_likelihood=-np.inf)


VARIANTS: dict[str, Variant] = {
    WHOLE: Variant({}, {}),
    "25 targets": Variant({"most_targets": 25}, {"mbtl.selectors.auto._ROWS": 1000}),
    "50 targets at all times": Variant({}, {"mbtl.selectors.auto._ROWS": 1000}),
    "no cover": Variant({"cover": 0}, {}),
    "cover every 2nd": Variant({"cover": 2}, {}),
    "cover every 4th": Variant({"cover": 4}, {}),
    "no straight lines": Variant({}, {"mbtl.selectors.auto.fit_linear_trend": never}),
    "no floor": Variant({}, {"mbtl.selectors.auto.floor_of": lambda y: float(y.min())}),
    "pairs always quiet": Variant({}, {"mbtl.models.transfer_gp._NOISIER": 1.0}),
    "one ceiling": Variant({}, {"mbtl.selectors.auto_beliefs.RowGain": OneCeiling}),
    "no finalists": Variant({"finalists": 0}, {}),
    "finalists on all targets": Variant({"finalists": 30, "final_targets": 1000}, {}),
    "no search": Variant({}, {"mbtl.selectors.auto._LEADERS": 0}),
}


def sets(which: str, trials: int) -> dict[str, RowSource]:
    """Sources of rows by name."""
    if which == "shipped":
        found = dict(open_matrices(["all"]))  # the twins of the defaults say nothing new
        return {name: one for name, one in found.items() if not name.endswith("-final")}
    if which == "axes":
        return {i: load_by_id(i) for i in shipped_matrices() if load_by_id(i).space.d > 1}
    if which == "worlds":
        return {world.name: world for world in worlds(3)}
    return {world.name: world for world in sd_worlds(3, noise=5, n_seeds=max(trials, 1))}


@dataclass(frozen=True)
class Known:
    """Of one matrix seed: Random and the oracle (K,), and what V is a share of the way between."""

    random: Array
    oracle: Array
    low: float
    high: float


def known(source: RowSource, seed: int, budget: int) -> Known:
    """The references of one matrix seed."""
    there = levels(source, seed)
    return Known(
        random_curve(source, seed, budget),
        sequential_oracle(source, seed, budget).curve,
        there.grand_mean,
        there.oracle_transfer,
    )


def curves(chosen: Variant, sources: Mapping[str, RowSource], budget: int, trials: int) -> Array:
    """(runs, K) V of one variant."""
    found = []
    with chosen.applied() as auto:
        for source in sources.values():
            fair = held_out(auto, getattr(source, "cmdp", ""))
            problem = source.problem(min(budget, source.n))
            for seed in range(min(source.n_seeds, trials)):
                history = replay(
                    fair, problem, lambda i, s=seed, o=source: o.rows(s, [i])[0], trial=seed
                ).history
                found.append(measured_curve(source, seed, history.sources))
    return np.array(found)


def compared(ours: Array, whole: Array, refs: list[Known]) -> dict[str, Any]:
    """Figures of one variant beside the whole `auto`, over the same runs."""
    random, oracle = (np.array([getattr(r, k) for r in refs]) for k in ("random", "oracle"))
    rng, out = np.random.default_rng(0), {}
    draws = rng.integers(len(refs), size=(DRAWS, len(refs)))
    for name, some in (("at K", slice(-1, None)), ("curve", slice(None))):
        room = (oracle - random)[:, some].sum(axis=1)
        gains = [(one - random)[:, some].sum(axis=1) for one in (ours, whole)]
        mine, full = (gain.sum() / room.sum() for gain in gains)
        again = (gains[0] - gains[1])[draws].sum(axis=1) / room[draws].sum(axis=1)
        low, high = np.quantile(again, [0.025, 0.975])
        out[name] = [digits(float(v), 3) for v in (mine, mine - full, low, high)]
    more = np.array(
        [
            [
                np.log((a or len(one) + 1) / (b or len(one) + 1))
                for a, b in zip(
                    trainings_to(one, r.low, r.high), trainings_to(two, r.low, r.high), strict=True
                )
            ]
            for one, two, r in zip(ours, whole, refs, strict=True)
        ]
    ).mean(axis=1)
    error = float(more.std(ddof=1) / np.sqrt(len(more))) if len(more) > 1 else 0.0
    out["trainings"] = [digits(100 * float(np.expm1(more.mean())), 3), digits(100 * error, 3)]
    return out


def line(label: str, found: Mapping[str, Any], seconds: float) -> str:
    """One row of the table."""
    cells = [label]
    for name in ("at K", "curve"):
        value, more, low, high = found[name]
        cells.append(f"{value:.3f} ({more:+.3f} [{low:+.3f}, {high:+.3f}])")
    more, error = found["trainings"]
    return f"| {' | '.join([*cells, f'{more:+.1f} ± {error:.1f}', f'{seconds:.0f}'])} |"


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--set", choices=("shipped", "axes", "worlds", "sd"), default="shipped")
    parser.add_argument("--budget", type=int, default=20)
    parser.add_argument("--trials", type=int, default=3, help="seeds of every matrix")
    parser.add_argument("--only", default="", help="part of the name of a matrix or world")
    parser.add_argument("--variants", default=",".join(VARIANTS))
    args = parser.parse_args()
    sources = {k: v for k, v in sets(args.set, args.trials).items() if args.only in k}
    refs = [
        known(source, seed, args.budget)
        for source in sources.values()
        for seed in range(min(source.n_seeds, args.trials))
    ]
    note(f"{len(refs)} runs of {args.budget} trainings")
    head = "| variant | closed at K | closed under the curve | trainings, % | processor s |"
    lines, document, whole = [head, "|---" * 5 + "|"], {}, np.empty(0)
    for label in dict.fromkeys([WHOLE, *args.variants.split(",")]):
        begin = time.process_time()
        ours = curves(VARIANTS[label], sources, args.budget, args.trials)
        seconds = time.process_time() - begin
        whole = ours if label == WHOLE else whole
        document[label] = compared(ours, whole, refs) | {"seconds": digits(seconds, 3)}
        lines.append(line(label, document[label], seconds))
        note(lines[-1])
    found = {"set": args.set, "variants": document, "machine": measure.machine()}
    measure.show(found, lines, as_json=args.json)


if __name__ == "__main__":
    main()
