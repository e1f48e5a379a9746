"""What `auto` makes of what real studies have: noise, partial rows, costs, luck, batches, an end.

    .venv/bin/python benchmarks/real_studies.py [--parts noise,partial,...] [--sets a,b]

Plays on all seeds of shipped matrices (of 100 contexts every second), with the prior that has not
seen their family, on all cores. V is always that of the true rows, of the policies that the study
would use.
"regret" is the distance to Oracle Transfer in V, as a share of that of one random policy.

    noise     Gaussian noise on every entry that the selector sees: told its size, or not
    partial   each policy evaluated on so many targets: evenly spaced, or random ones
    costs     a training costs 1 to 10, rising along the contexts; budget 30: heeded, or not
    repeats   a context may be trained again (the rows of the other seeds): allowed, or not
    batches   n picks at a time, each without the rows of the others
    stopping  the study ends when auto says that one more training gains < 0.01 with 90 %: how many
              trainings, and how often the next one gained less indeed
"""

from __future__ import annotations

import measure  # noqa: F401  first: threads

import argparse  # isort: skip
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor as Pool
from dataclasses import replace
from multiprocessing import get_context
from typing import Any

import numpy as np
from learn_prior import halved

from mbtl.arrays import Array
from mbtl.benchmark.shipped import family_of
from mbtl.history import History
from mbtl.objective import nearest_filled, value
from mbtl.selectors import Auto, SelectionProblem
from mbtl.selectors.targets import spread_targets
from mbtl.study.asking import LEAST_ROWS

SETS = (
    "cartpole-length,cartpole-length-dqn,pendulum-length-hidden,pendulum-timestep,ring-acc,ring-vel"
)
K = 10
Rows = Array


def worlds(name: str, budget: int = K) -> Iterator[tuple[SelectionProblem, list[Rows]]]:
    """Problem, and the true rows of each seed, rotated so that the first is the study's own."""
    part, every = halved(name, budget)
    for s in range(len(every)):
        yield part, every[s:] + every[:s]


def regret(truth: Rows, trained: list[Array], seen: Array) -> float:
    """Of the policies that rows `seen` (k, N) choose per target, NaN where not evaluated.

    As a portfolio does: a policy counts as on the nearest target where it was evaluated.
    """
    steps = np.arange(seen.shape[1], dtype=np.float64)[:, None]
    routes = nearest_filled(seen, steps).argmax(axis=0)
    reached = np.take_along_axis(np.stack(trained), routes[None], axis=0)[0]
    low, high = truth.mean(), truth.max(axis=0).mean()
    return float((high - reached.mean()) / (high - low))


def auto(name: str) -> Auto:
    return Auto().without(family_of(name))


def noise(name: str, sd: float, told: bool) -> Iterator[float]:
    for problem, rows in worlds(name):
        rng, history, trained = np.random.default_rng(0), History(problem.n), []
        for _ in range(K):
            source = auto(name).propose(problem, history, rng).source
            trained.append(rows[0][source])
            seen = np.vstack([history.rows, trained[-1] + sd * rng.standard_normal(problem.n)])
            errors = np.full(seen.shape, sd) if told else None
            history = History(problem.n, (*history.sources, source), seen, errors=errors)
        yield regret(rows[0], trained, history.rows)


def partial(name: str, count: int, how: str) -> Iterator[float]:
    for problem, rows in worlds(name):
        rng, history, trained = np.random.default_rng(0), History(problem.n), []
        for _ in range(K):
            source = auto(name).propose(problem, history, rng).source
            if how == "even":
                chosen = spread_targets(problem, source, count)
            else:
                chosen = (source, *rng.choice(problem.n, count - 1, replace=False))
            row = np.full(problem.n, np.nan)
            row[list(chosen)] = rows[0][source][list(chosen)]
            history = history.with_row(source, row)
            trained.append(rows[0][source])
        yield regret(rows[0], trained, history.rows)


def costs(name: str, heeded: bool) -> Iterator[float]:
    """Not heeded: all that can be paid for costs the same."""
    for problem, rows in worlds(name, 40):
        price = np.linspace(1.0, 10.0, problem.n)
        history, left = History(problem.n), 30.0
        while price[history.open_mask(problem.n)].min() <= left:
            told = price if heeded else np.where(price <= left, 1.0, 2.0)
            asked = replace(problem, costs=told, cost_budget=left if heeded else 1.0)
            source = auto(name).propose(asked, history, np.random.default_rng(0)).source
            history, left = history.with_row(source, rows[0][source]), left - price[source]
        yield regret(rows[0], list(history.rows), history.rows)


def repeats(name: str, times: int) -> Iterator[float]:
    for problem, rows in worlds(name):
        history = History(problem.n)
        for _ in range(K):
            allowed = replace(problem, repeats=times)
            source = auto(name).propose(allowed, history, np.random.default_rng(0)).source
            again = history.sources.count(source)
            history = history.with_row(source, rows[again][source])
        yield regret(rows[0], list(history.rows), history.rows)


def batches(name: str, size: int) -> Iterator[float]:
    for problem, rows in worlds(name, 12):
        history = History(problem.n)
        while len(history) < 12:
            waiting = history
            for _ in range(min(size, 12 - len(history))):
                pick = auto(name).propose(problem, waiting, np.random.default_rng(0)).source
                waiting = waiting.with_pending(pick)
            for pick in waiting.pending:
                history = history.with_row(pick, rows[0][pick])
        yield regret(rows[0], list(history.rows), history.rows)


def stopping(name: str, least: float = 0.01, confidence: float = 0.9) -> Iterator[Array]:
    """Trainings until it says so, whether the next gained less, regret then; with K = 30."""
    for problem, rows in worlds(name, 30):
        history = History(problem.n)
        wish = replace(problem, least_gain=least)
        while len(history) < 30:
            proposal = auto(name).propose(wish, history, np.random.default_rng(0))
            row = rows[0][proposal.source]
            enough = proposal.chance is not None and 1.0 - proposal.chance >= confidence
            gain = value(np.maximum(history.best, row)) - value(history.best)
            if enough and len(history) >= LEAST_ROWS:
                left = regret(rows[0], list(history.rows), history.rows)
                yield np.array([len(history), gain < least, left])
                break
            history = history.with_row(proposal.source, row)
        else:
            yield np.array([31.0, np.nan, regret(rows[0], list(history.rows), history.rows)])


Plays = dict[str, tuple[Any, ...]]
"""By column a play of above, and what it takes beside the name of the set."""


def played(play: Callable[..., Iterator[Any]], name: str, *how: Any) -> Array:
    return np.mean(list(play(name, *how)), axis=0)


def ended(name: str) -> tuple[float, float, float]:
    """Means over seeds; of those that ended by the rule how many did so rightly, NaN if none."""
    k, less, left = np.array(list(stopping(name))).T
    right = float("nan") if np.isnan(less).all() else float(np.nanmean(less))
    return float(k.mean()), right, float(left.mean())


def table(pool: Pool, title: str, names: list[str], plays: Plays) -> None:
    print(f"\n{title}\n\n| regret at the end | {' | '.join(plays)} |")
    print("|---" * (len(plays) + 1) + "|")
    runs = [[pool.submit(played, p, n, *how) for p, *how in plays.values()] for n in names]
    found = np.array([[run.result() for run in row] for row in runs])
    for label, row in zip([*names, "mean"], [*found, found.mean(axis=0)], strict=True):
        print(f"| {label} | {' | '.join(f'{v:.3f}' for v in row)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", default="noise,partial,costs,repeats,batches,stopping")
    parser.add_argument("--sets", default=SETS)
    args = parser.parse_args()
    names, parts = args.sets.split(","), args.parts.split(",")
    tables: dict[str, tuple[str, Plays]] = {
        "noise": (
            f"Evaluation noise, K = {K}",
            {
                f"sd {sd:g} {'told' if told else 'not told'}": (noise, sd, told)
                for sd in (0.05, 0.2)
                for told in (True, False)
            },
        ),
        "partial": (
            f"Targets evaluated, K = {K}",
            {
                f"{count} {how}": (partial, count, how)
                for count in (5, 10, 20)
                for how in ("even", "random")
            }
            | {"all": (noise, 0.0, False)},
        ),
        "costs": (
            "Costs 1 to 10 along the contexts, budget 30",
            {"heeded": (costs, True), "not heeded": (costs, False)},
        ),
        "repeats": (
            f"Trained again, K = {K}",
            {f"{times} per context": (repeats, times) for times in (1, 3)},
        ),
        "batches": (
            "Batches, K = 12",
            {f"{size} at a time": (batches, size) for size in (1, 2, 4, 6)},
        ),
    }
    with Pool(mp_context=get_context("spawn")) as pool:
        for title, plays in (tables[part] for part in parts if part in tables):
            table(pool, title, names, plays)
        if "stopping" in parts:
            print("\nStopping at a gain < 0.01 with 90 %, K = 30\n")
            print("| | trainings | next one gained less | regret then |\n|---|---|---|---|")
            for name, run in [(name, pool.submit(ended, name)) for name in names]:
                k, right, left = run.result()
                said = "-" if np.isnan(right) else f"{right:.2f}"
                print(f"| {name} | {k:.1f} | {said} | {left:.3f} |", flush=True)


if __name__ == "__main__":
    main()
