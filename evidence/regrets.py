"""Regrets of `auto`: V at every budget, minus that of the best rival there.

    python evidence/regrets.py [--folder runs/transfers] [--cmdps a b] [--without]

Trainings of every kind are replayed on transfer data. Rivals, each by the mean over seeds: the
paper's MBTL, Greedy, Random's mean, k-means, m-mbtl, the chooser of specialists alone; one policy
for all with all the units; that policy with one unit and then random specialists. A regret is
negative where a rival is ahead. Shares are of the way from one random specialist (0) to Oracle
Transfer of all specialists (1).

Last comes what beginning with everybody costs, where it gains nothing: V of K specialists in random
order, less that of the policy for all and K - 1 of them. It is at most what one pick of such an
order adds in the mean, (V_K - V_1) / (K - 1), since the mean curve of Random is concave.

The upper line is the Sequential Oracle over all kinds of trainings. It knows every row beforehand:
the best length of the policy for all, then the specialist or tuned copy that adds most per unit.

`--without` leaves out each device of `auto` in turn. The model of the chooser has not seen the
family; the shares that are usual were chosen on all of these data.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import UnknownName
from mbtl.history import History
from mbtl.selectors import Proposal, SelectionProblem, Selector, get_selector
from mbtl.strategies import OnePolicy
from mbtl.strategies.auto import Auto
from mbtl.zoo.benchmark import levels
from mbtl.zoo.benchmark.oracle import random_curve
from mbtl.zoo.benchmark.trainings import TransferWorld, replay_trainings, specialists_of
from mbtl.zoo.benchmark.transfers import TransferData, load_transfers, transfer_ids
from mbtl.zoo.cmdps import get_cmdp

BUDGETS = tuple(range(1, 16))
CHOOSERS = ("mbtl", "greedy", "kmeans", "m-mbtl", "specialists")
ORDERS = 200
"""Random orders of specialists after the policy for all."""


@dataclass(frozen=True)
class Table:
    """One CMDP, seeds stacked; V at every budget.

    Attributes:
        rivals: name -> (S, B).
        low, high: (S,) one random specialist, Oracle Transfer.
    """

    rivals: Mapping[str, Array]
    low: Array
    high: Array

    def share(self, value: Array) -> Array:
        """(B,) of the way, seeds as a ratio of sums."""
        return (value - self.low[:, None]).sum(0) / (self.high - self.low).sum()

    def regret(self, value: Array) -> Array:
        """(B,) V minus that of the best rival."""
        return value.mean(0) - np.max([rows.mean(0) for rows in self.rivals.values()], axis=0)

    def behind(self, value: Array) -> Array:
        """(B,) whether by more than .01 beyond noise, two standard errors over seeds.

        Where one policy for all is worth less than a random specialist, rivals have a unit less:
        the one that shows it.
        """
        price = int(self.rivals["one policy"][:, 0].mean() < self.low.mean())
        found = np.zeros(len(BUDGETS), dtype=bool)
        for i in range(price, len(BUDGETS)):
            best = max((rows[:, i - price] for rows in self.rivals.values()), key=np.mean)
            lead = value[:, i] - best
            noise = lead.std(ddof=1) / len(lead) ** 0.5 if len(lead) > 1 else 0.0
            found[i] = lead.mean() + 2.0 * noise < -0.01
        return found


@dataclass(frozen=True)
class Remembering:
    """A chooser that is not asked twice in the same situation, by runs of other budgets."""

    chooser: Selector
    name: str = "remembering"
    answers: dict[bytes, Proposal] = field(default_factory=dict)

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """As it was answered before, or as the chooser says."""
        entries = (history.rows, history.others, history.pending, history.failed, problem.weights)
        arrays = [np.asarray(() if one is None else one, dtype=float) for one in entries]
        key = b"|".join(one.tobytes() for one in (*arrays, np.array(history.sources)))
        if key not in self.answers:
            self.answers[key] = self.chooser.propose(problem, history, rng)
        return self.answers[key]


SAME = {"cart": "cartpole", "swing": "pendulum"}
"""Small problems of a simulator that CMDPs have, too."""


def family_of(name: str) -> str:
    prefix = name.split("-")[0]
    return SAME.get(prefix, prefix)


def theta_of(name: str) -> float | None:
    try:
        return get_cmdp(name).theta
    except UnknownName:
        return None


def world_of(data: TransferData, seed: int) -> TransferWorld:
    return TransferWorld(data, seed, theta_of(data.name))


def table_of(data: TransferData) -> Table:
    theta = theta_of(data.name)
    matrix, family = specialists_of(data, theta), family_of(data.name)
    rivals: dict[str, list[list[float]]] = {}
    most = min(len(data.sources), BUDGETS[-1])
    for seed in range(data.n_seeds):
        world = world_of(data, seed)
        for name in CHOOSERS:
            selector = get_selector(name)
            selector = selector.without(family) if hasattr(selector, "without") else selector
            if name == "greedy" and len(data.space.axes) > 1:
                continue
            run = replay_trainings(selector, world, BUDGETS[-1])
            rivals.setdefault(name, []).append([run.at(b) for b in BUDGETS])
        curve = random_curve(matrix, seed, most)
        rivals.setdefault("random", []).append([curve[min(b, most) - 1] for b in BUDGETS])
        run = replay_trainings(OnePolicy(), world, BUDGETS[-1])
        rivals.setdefault("one policy", []).append([run.at(b) for b in BUDGETS])
        rivals.setdefault("all, then random", []).append(all_then_random(data, seed))
    known = [levels(matrix, seed) for seed in range(data.n_seeds)]
    return Table(
        {name: np.array(rows) for name, rows in rivals.items()},
        np.array([one.grand_mean for one in known]),
        np.array([one.oracle_transfer for one in known]),
    )


def oracle(data: TransferData, seed: int, budget: float) -> float:
    """V of the Sequential Oracle over all kinds; it chooses by the episodes that strategies see."""
    weights, marks = data.space.weights, data.generalists
    rows = {(0.0, 1.0): data.specialists[seed]} | {k: raw[seed] for k, raw in data.tuned.items()}
    known = {pair: data.bounds.normalise(raw) for pair, raw in rows.items()}
    plans = []
    for length in (0.0, *(units for units in marks if units <= budget)):
        best, now = np.full((2, data.n), -np.inf)
        done = [data.bounds.normalise(raw[seed]) for u, raw in marks.items() if u <= length]
        left = budget - length
        while True:
            for seen, fresh in done:
                now, best = np.where(seen > best, fresh, now), np.maximum(seen, best)
            worth = {
                pair: (np.maximum(each[0], best) - np.maximum(best, -1e6)) @ weights / pair[1]
                for pair, each in known.items()
                if pair[0] <= length and pair[1] <= left
            }
            if not worth:
                break
            pair = max(worth, key=lambda one: worth[one].max())
            which = int(worth[pair].argmax())
            done, left = [known[pair][:, which]], left - pair[1]
        plans.append((best @ weights, now @ weights))
    return float(max(plans)[1])


def all_then_random(data: TransferData, seed: int) -> list[float]:
    """Mean V over orders of the policy for all with one unit and specialists."""
    weights, rng = data.space.weights, np.random.default_rng(0)
    seen, fresh = data.bounds.normalise(data.specialists[seed])
    total = np.zeros(len(BUDGETS))
    for _ in range(ORDERS):
        best, now = (row.copy() for row in data.bounds.normalise(data.generalists[1.0][seed]))
        order = rng.permutation(len(seen))
        for i, budget in enumerate(BUDGETS):
            if 1 < budget <= len(order) + 1:
                row = order[budget - 2]
                wins = seen[row] > best
                now[wins], best[wins] = fresh[row][wins], seen[row][wins]
            total[i] += now @ weights
    return (total / ORDERS).tolist()


def price_of_all(tables: Sequence[Table]) -> str:
    """What the first unit costs at 3, 5, 10 and 15 units, and what it costs at most."""
    at = np.array([3, 5, 10, 15]) - 1
    cost, most = [], []
    for table in tables:
        curve, after = (table.rivals[k].mean(0) for k in ("random", "all, then random"))
        cost.append((curve - after)[at])
        most.append((curve[at] - curve[0]) / at)
    rows = [f"{np.mean(x, 0).round(3)}, worst {np.max(x, 0).round(3)}" for x in (cost, most)]
    return f"beginning with all, at 3, 5, 10, 15 units, costs {rows[0]}, and at most {rows[1]}"


def values(strategy: Auto, data: TransferData, budgets: tuple[int, ...]) -> Array:
    """(S, B) V of a strategy that knows its budget, a run for each."""
    honest, found = strategy.without(family_of(data.name)), []
    for seed in range(data.n_seeds):
        once = replace(honest, chooser=Remembering(honest.chooser))
        runs = [replay_trainings(once, world_of(data, seed), budget) for budget in budgets]
        found.append([run.at(budget) for run, budget in zip(runs, budgets, strict=True)])
    return np.array(found)


def variants() -> dict[str, Auto]:
    """`auto`, and without each of its devices."""
    auto = Auto()
    return {
        "auto": auto,
        "no early look": replace(auto, first=1.0),
        "nothing is usual": replace(auto, doubt=1e-3),
        "nothing is usual of a doubling": replace(auto, double_share=0.0),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", help="of transfer data; those of the package when missing")
    parser.add_argument("--cmdps", nargs="+", help="some of them")
    parser.add_argument("--without", action="store_true", help="leave out each device, too")
    args = parser.parse_args()
    names = args.cmdps or transfer_ids(args.folder)
    strategies = variants() if args.without else {"auto": Auto()}
    found: dict[str, dict[str, dict[str, Any]]] = {label: {} for label in strategies}
    tables = []
    for name in names:
        data = load_transfers(name, folder=args.folder)
        table = table_of(data)
        tables.append(table)
        upper = np.array([[oracle(data, s, b) for b in BUDGETS] for s in range(data.n_seeds)])
        for label, strategy in strategies.items():
            value = values(strategy, data, BUDGETS)
            best = [
                max(table.rivals, key=lambda who: table.rivals[who].mean(0)[i])
                for i in range(len(BUDGETS))
            ]
            found[label][name] = {
                "regret": table.regret(value).round(4),
                "behind": table.behind(value),
                "share": table.share(value).round(3),
                "oracle": table.share(upper).round(3),
                "rival": best,
                "value": value.mean(0),
                "paper": table.rivals["mbtl"].mean(0),
                "every": table.high.mean(),
            }
        print(name, file=sys.stderr, flush=True)
    for label, rows in found.items():
        print(f"\n{label}" if args.without else "")
        if label == "auto":
            show(rows)
        total(rows)
    print(f"\n{price_of_all(tables)}")


def show(rows: Mapping[str, Mapping[str, Any]]) -> None:
    """One line per CMDP."""
    heads = "worst regret | at units | behind | mean | share at 3 | oracle | at 15 | oracle"
    print(f"| CMDP | {heads} |\n|{'---|' * 9}")
    for name, row in rows.items():
        regret = row["regret"]
        at = int(regret.argmin())
        print(
            f"| {name} | {regret[at]:.3f} | {BUDGETS[at]} | {row['rival'][at]} "
            f"| {regret.mean():.3f} | {row['share'][2]:.2f} | {row['oracle'][2]:.2f} "
            f"| {row['share'][-1]:.2f} | {row['oracle'][-1]:.2f} |"
        )


def total(rows: Mapping[str, Mapping[str, Any]]) -> None:
    """In one line."""
    regrets = np.array([row["regret"] for row in rows.values()])
    shares, above = (np.array([r[k] for r in rows.values()]) for k in ("share", "oracle"))
    print(
        f"\n{len(rows)} CMDPs: worst {regrets.min():.3f}, mean {regrets.mean():.3f}, mean of the "
        f"worst {regrets.min(1).mean():.3f}, behind by more than .01 at "
        f"{(regrets < -0.01).mean():.0%} of budgets, beyond noise and the price of a look at "
        f"{np.mean([row['behind'] for row in rows.values()]):.1%}; median share at 3 units "
        f"{np.median(shares[:, 2]):.2f}, at 15 {np.median(shares[:, -1]):.2f} (oracle "
        f"{np.median(above[:, 2]):.2f}, {np.median(above[:, -1]):.2f}); at 15 above Oracle "
        f"Transfer on {(shares[:, -1] > 1.0).sum()}"
    )
    value, paper, every = (np.array([r[k] for r in rows.values()]) for k in _COMPARED)
    for units in _AT:
        own = value[:, units - 1]
        print(
            f"{units} units: V {own.mean():.3f}; less mbtl {_paired(own - paper[:, units - 1])}; "
            f"less all specialists {_paired(own - every)}"
        )


_COMPARED, _AT = ("value", "paper", "every"), (1, 2, 3, 5, 8, 15)


def _paired(lead: Array) -> str:
    """Mean, its standard error over CMDPs, and on how many it is more than .01 either way."""
    error = lead.std(ddof=1) / len(lead) ** 0.5 if len(lead) > 1 else 0.0
    ahead, behind = (lead > 0.01).sum(), (lead < -0.01).sum()
    return f"{lead.mean():+.3f} ± {error:.3f}, ahead on {ahead}, behind on {behind}"


if __name__ == "__main__":
    main()
