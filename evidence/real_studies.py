"""What `specialists` makes of what real studies have: noise, partial rows, costs, batches, an end.

    .venv/bin/python evidence/real_studies.py [--parts noise,partial,...]

Plays on all seeds of shipped matrices (of 100 contexts every second), with the prior that has not
seen their family, on all cores. V is always that of the true rows, of the policies that the study
would use.
"regret" is the distance to Oracle Transfer in V, as a share of that of one random policy.

    noise     Gaussian noise on every entry that the selector sees: told its size, or not
    partial   each policy evaluated on so many targets: spread, or random ones
    costs     a training costs 1 to 10, rising or falling along the contexts; budget 30: considered,
              or ignored
    batches   n picks at a time, each without the rows of the others
    nothing   the study ends when all trainings left together gain < 0.005 with 90 %, as `mbtl run`
              does: how many trainings, and what those left out would have gained
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor as Pool
from dataclasses import replace
from itertools import product
from multiprocessing import get_context
from typing import Any

import numpy as np
from learn_prior import small

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace, Linear
from mbtl.history import History
from mbtl.models.beliefs import Beliefs
from mbtl.objective import value
from mbtl.routing import last_route
from mbtl.selectors import Specialists
from mbtl.selectors.targets import spread_targets
from mbtl.study.ask import LEAST_ROWS
from mbtl.zoo.benchmark.shipped import family_of

SETS = (
    "cartpole-length,cartpole-length-dqn,pendulum-length-hidden,pendulum-timestep,ring-acc,ring-vel"
)
K = 10
LEAST, SURE = 0.005, 0.9
"""A study ends where all trainings left gain less than that, with so much certainty."""


def regret(truth: Array, history: History, sd: float | None = None) -> float:
    """Of the policies that a study would route by this history, measured on the true rows.

    `sd` is the noise of every entry that the study was told.
    """
    n = truth.shape[1]
    space = ContextSpace.grid({Linear("x", 0.0, n - 1.0): n})
    known = None if sd is None else np.full(history.rows.shape, sd)
    believed = Beliefs(space, history.sources, history.rows, known).on(np.arange(n))[0]
    served = last_route(believed, history.sources, space.steps)
    return share_left(truth, truth[list(history.sources)][served, np.arange(n)])


def share_left(truth: Array, reached: Array) -> float:
    """Distance to Oracle Transfer as a share of that of one random policy."""
    low, high = truth.mean(), truth.max(axis=0).mean()
    return float((high - reached.mean()) / (high - low))


def specialists(name: str) -> Specialists:
    return Specialists().without(family_of(name))


def noise(name: str, sd: float, told: bool) -> Iterator[float]:
    for problem, rows in small(name, K):
        rng, history = np.random.default_rng(0), History(problem.n)
        for _ in range(K):
            source = specialists(name).propose(problem, history, rng).source
            noisy = rows[source] + sd * rng.standard_normal(problem.n)
            seen = np.vstack([history.rows, noisy])
            errors = np.full(seen.shape, sd) if told else None
            history = History(problem.n, (*history.sources, source), seen, errors=errors)
        yield regret(rows, history, sd if told else None)


def partial(name: str, count: int, how: str) -> Iterator[float]:
    for problem, rows in small(name, K):
        rng, history = np.random.default_rng(0), History(problem.n)
        for _ in range(K):
            source = specialists(name).propose(problem, history, rng).source
            if how == "spread":
                chosen = spread_targets(problem, source, count)
            else:
                chosen = (source, *rng.choice(problem.n, count - 1, replace=False))
            row = np.full(problem.n, np.nan)
            row[list(chosen)] = rows[source][list(chosen)]
            history = history.with_row(source, row)
        yield regret(rows, history)


def costs(name: str, considered: bool, rising: bool) -> Iterator[float]:
    """Not considered: all that can be paid for costs the same."""
    for problem, rows in small(name, 40):
        price = np.linspace(1.0, 10.0, problem.n)[:: 1 if rising else -1]
        history, left = History(problem.n), 30.0
        while price[history.open_mask(problem.n)].min() <= left:
            told = price if considered else np.where(price <= left, 1.0, 2.0)
            asked = replace(problem, costs=told, cost_budget=left if considered else 1.0)
            source = specialists(name).propose(asked, history, np.random.default_rng(0)).source
            history, left = history.with_row(source, rows[source]), left - price[source]
        yield regret(rows, history)


def batches(name: str, size: int) -> Iterator[float]:
    for problem, rows in small(name, 12):
        history = History(problem.n)
        while len(history) < 12:
            waiting = history
            for _ in range(min(size, 12 - len(history))):
                pick = specialists(name).propose(problem, waiting, np.random.default_rng(0)).source
                waiting = waiting.with_pending(pick)
            for pick in waiting.pending:
                history = history.with_row(pick, rows[pick])
        yield regret(rows, history)


def ended(name: str) -> tuple[float, float, float]:
    """Trainings until the rule ends the study (31: never), what all contexts would still have
    gained where it did, and regret then; means over seeds, K = 30.
    """
    found = []
    for problem, rows in small(name, 30):
        history, wish = History(problem.n), replace(problem, least_left=LEAST)
        while len(history) < 30:
            proposal = specialists(name).propose(wish, history, np.random.default_rng(0))
            chance = proposal.chance_left
            if chance is not None and 1.0 - chance >= SURE and len(history) >= LEAST_ROWS:
                gain = value(np.maximum(history.best, rows.max(axis=0))) - value(history.best)
                found.append((len(history), gain, share_left(rows, history.best)))
                break
            history = history.with_row(proposal.source, rows[proposal.source])
        else:
            found.append((31, np.nan, share_left(rows, history.best)))
    k, gain, left = np.array(found, float).T
    gained = float("nan") if np.isnan(gain).all() else float(np.nanmean(gain))
    return float(k.mean()), gained, float(left.mean())


Column = tuple[Any, ...]
"""Its head, a play of above, and what that takes beside the name of the set."""
PARTS: dict[str, list[Column]] = {
    "noise": [
        (f"sd {sd:g} {said}", noise, sd, said == "told")
        for sd, said in product((0.05, 0.2), ("told", "not told"))
    ],
    "partial": [
        *((f"{n} {how}", partial, n, how) for n, how in product((5, 10, 20), ("spread", "random"))),
        ("all", noise, 0.0, False),
    ],
    "costs": [
        (f"{way}, {said}", costs, said == "considered", way == "rising")
        for way, said in product(("rising", "falling"), ("considered", "ignored"))
    ],
    "batches": [(f"{n} at a time", batches, n) for n in (1, 2, 4, 6)],
}


def played(play: Callable[..., Iterator[float]], name: str, *how: Any) -> float:
    return float(np.mean(list(play(name, *how))))


def table(pool: Pool, part: str, names: list[str]) -> None:
    columns = PARTS[part]
    print(f"\n| {part}: regret at the end | {' | '.join(head for head, *_ in columns)} |")
    print("|---" * (len(columns) + 1) + "|")
    runs = [[pool.submit(played, p, n, *how) for _, p, *how in columns] for n in names]
    found = np.array([[run.result() for run in row] for row in runs])
    for label, row in zip([*names, "mean"], [*found, found.mean(axis=0)], strict=True):
        print(f"| {label} | {' | '.join(f'{v:.3f}' for v in row)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", default="noise,partial,costs,batches,nothing")
    args = parser.parse_args()
    names, parts = SETS.split(","), args.parts.split(",")
    with Pool(mp_context=get_context("spawn")) as pool:
        for part in PARTS:
            if part in parts:
                table(pool, part, names)
        if "nothing" in parts:
            print(f"\nStopping where all left together gain < {LEAST:g} with {SURE:.0%}, K = 30\n")
            print("| | trainings | all left together gained | regret then |\n|---|---|---|---|")
            for name, run in [(name, pool.submit(ended, name)) for name in names]:
                k, gained, left = run.result()
                said = "-" if np.isnan(gained) else f"{gained:.4f}"
                print(f"| {name} | {k:.1f} | {said} | {left:.3f} |", flush=True)


if __name__ == "__main__":
    main()
