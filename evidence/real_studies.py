"""What `auto` makes of what real studies have: noise, partial rows, costs, luck, batches, an end.

    .venv/bin/python evidence/real_studies.py [--parts noise,partial,...] [--sets a,b]

Plays on all seeds of shipped matrices (of 100 contexts every second), with the prior that has not
seen their family, on all cores. V is always that of the true rows, of the policies that the study
would use.
"regret" is the distance to Oracle Transfer in V, as a share of that of one random policy.

    noise     Gaussian noise on every entry that the selector sees: told its size, or not
    partial   each policy evaluated on so many targets: spread, or random ones
    axes      the same with one, two and three axes, and whether V is what a study says it is
    costs     a training costs 1 to 10, rising or falling along the contexts; budget 30: heeded, or
              not
    batches   n picks at a time, each without the rows of the others
    stopping  the study ends when auto says that one more training gains < 0.01 with 90 %: how many
              trainings, and how often the next one gained less indeed
    nothing   ... that all trainings left together gain < 0.005 with 90 %, as `mbtl run` does: how
              many trainings, and what those left out would have gained
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
from several_axes import World

from mbtl.arrays import Array
from mbtl.contexts import ContextSpace, Linear
from mbtl.history import History
from mbtl.models.beliefs import Beliefs
from mbtl.objective import value
from mbtl.routing import Indices, Routing, last_route
from mbtl.selectors import Auto, SelectionProblem
from mbtl.selectors.targets import spread_targets
from mbtl.study.ask import LEAST_ROWS
from mbtl.zoo.benchmark.shipped import family_of, load_by_id

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


def regret(truth: Rows, history: History, sd: float | None = None) -> float:
    """Of the policies that a study would route by this history, measured on the true rows."""
    n = truth.shape[1]
    space = ContextSpace.grid({Linear("x", 0.0, n - 1.0): n})
    served = route(space, history, sd)
    return share_left(truth, truth[list(history.sources)][served, np.arange(n)])


def route(space: ContextSpace, history: History, sd: float | None = None) -> Indices:
    """(N,) as a study has it, told that every entry has noise of `sd`, of its own."""
    known = None if sd is None else np.full(history.rows.shape, sd)
    believed = Beliefs(space, history.sources, history.rows, known).on(np.arange(space.n))[0]
    return last_route(believed, history.sources, space.steps)


def share_left(truth: Rows, reached: Array) -> float:
    """Distance to Oracle Transfer as a share of that of one random policy."""
    low, high = truth.mean(), truth.max(axis=0).mean()
    return float((high - reached.mean()) / (high - low))


def auto(name: str) -> Auto:
    return Auto().without(family_of(name))


def noise(name: str, sd: float, told: bool) -> Iterator[float]:
    for problem, rows in worlds(name):
        rng, history = np.random.default_rng(0), History(problem.n)
        for _ in range(K):
            source = auto(name).propose(problem, history, rng).source
            noisy = rows[0][source] + sd * rng.standard_normal(problem.n)
            seen = np.vstack([history.rows, noisy])
            errors = np.full(seen.shape, sd) if told else None
            history = History(problem.n, (*history.sources, source), seen, errors=errors)
        yield regret(rows[0], history, sd if told else None)


def partial(name: str, count: int, how: str) -> Iterator[float]:
    for problem, rows in worlds(name):
        yield regret(rows[0], few(auto(name), problem, lambda i, own=rows[0]: own[i], count, how))


def few(
    selector: Auto,
    problem: SelectionProblem,
    row_of: Callable[[int], Array],
    count: int,
    how: str = "spread",
) -> History:
    """K picks, each evaluated on few targets."""
    rng, history = np.random.default_rng(0), History(problem.n)
    for _ in range(K):
        source = selector.propose(problem, history, rng).source
        if how == "spread":
            chosen = spread_targets(problem, source, count)
        else:
            chosen = (source, *rng.choice(problem.n, count - 1, replace=False))
        row = np.full(problem.n, np.nan)
        row[list(chosen)] = row_of(source)[list(chosen)]
        history = history.with_row(source, row)
    return history


def axes(which: str, count: int) -> Iterator[tuple[float, float, float]]:
    """Regret, |V said - V true|, and whether V is within its interval; one world after another."""
    for source in several(which):
        problem, space = source.problem(K), source.space
        every = np.arange(source.n)
        for seed in range(source.n_seeds):
            truth = source.rows(seed, every)
            own = auto(source.name)
            history = few(own, problem, lambda i, truth=truth: truth[i], count)
            found = Routing(space, history.sources, history.rows)
            reached = truth[list(history.sources)][found.route, every]
            wrong = abs(found.value.value - reached.mean())
            yield share_left(truth, reached), wrong, wrong <= 1.96 * found.value.error


def several(which: str) -> list[Any]:
    """Worlds with one, two or three axes: shipped matrices, and ones of known structure."""
    if which == "1 axis":
        return [load_by_id(name) for name in ("cartpole-length", "pendulum-length", "ring-acc")]
    square = ContextSpace.grid({Linear(name, 0, 1): 12 for name in "ab"})
    cube = ContextSpace.grid({Linear(name, 0, 1): 6 for name in "abc"})
    reach = {"a": 0.3, "b": 0.3}
    if which == "2 axes":
        return [
            World("2 axes, both matter", square, reach),
            World("2 axes, 1 matters, 1 hard", square, {"a": 0.2}, {"b": 0.4}),
        ]
    return [
        World("3 axes, all matter", cube, {**reach, "c": 0.3}),
        World("3 axes, 2 matter, 1 hard", cube, reach, {"c": 0.4}),
    ]


def costs(name: str, heeded: bool, rising: bool) -> Iterator[float]:
    """Not heeded: all that can be paid for costs the same."""
    for problem, rows in worlds(name, 40):
        price = np.linspace(1.0, 10.0, problem.n)[:: 1 if rising else -1]
        history, left = History(problem.n), 30.0
        while price[history.open_mask(problem.n)].min() <= left:
            told = price if heeded else np.where(price <= left, 1.0, 2.0)
            asked = replace(problem, costs=told, cost_budget=left if heeded else 1.0)
            source = auto(name).propose(asked, history, np.random.default_rng(0)).source
            history, left = history.with_row(source, rows[0][source]), left - price[source]
        yield regret(rows[0], history)


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
        yield regret(rows[0], history)


def stopping(name: str, rule: str, least: float, confidence: float = 0.9) -> Iterator[Array]:
    """Trainings until a rule ends the study, what was gained after that, regret then; K = 30.

    What was gained is that of the next training ("one"), or of all contexts together ("all").
    """
    wishes = {"one": "least_gain", "all": "least_left"}
    for problem, rows in worlds(name, 30):
        history, wish = History(problem.n), replace(problem, **{wishes[rule]: least})
        while len(history) < 30:
            proposal = auto(name).propose(wish, history, np.random.default_rng(0))
            row = rows[0][proposal.source]
            chance = proposal.chance if rule == "one" else proposal.chance_left
            if chance is not None and 1.0 - chance >= confidence and len(history) >= LEAST_ROWS:
                coming = row if rule == "one" else rows[0].max(axis=0)
                gain = value(np.maximum(history.best, coming)) - value(history.best)
                yield np.array([len(history), gain, share_left(rows[0], history.best)])
                break
            history = history.with_row(proposal.source, row)
        else:
            yield np.array([31.0, np.nan, share_left(rows[0], history.best)])


Plays = dict[str, tuple[Any, ...]]
"""By column a play of above, and what it takes beside the name of the set."""


def played(play: Callable[..., Iterator[Any]], name: str, *how: Any) -> Array:
    return np.mean(list(play(name, *how)), axis=0)


def ended(name: str, rule: str, least: float) -> tuple[float, float, float]:
    """Means over seeds; of those that ended by the rule what was left to gain, NaN if none."""
    k, gain, left = np.array(list(stopping(name, rule, least))).T
    gained = float("nan") if np.isnan(gain).all() else float(np.nanmean(gain))
    return float(k.mean()), gained, float(left.mean())


def table(pool: Pool, title: str, names: list[str], plays: Plays) -> None:
    print(f"\n{title}\n\n| regret at the end | {' | '.join(plays)} |")
    print("|---" * (len(plays) + 1) + "|")
    runs = [[pool.submit(played, p, n, *how) for p, *how in plays.values()] for n in names]
    found = np.array([[run.result() for run in row] for row in runs])
    for label, row in zip([*names, "mean"], [*found, found.mean(axis=0)], strict=True):
        print(f"| {label} | {' | '.join(f'{v:.3f}' for v in row)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    every = "noise,partial,axes,costs,batches,stopping,nothing"
    parser.add_argument("--parts", default=every)
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
                for how in ("spread", "random")
            }
            | {"all": (noise, 0.0, False)},
        ),
        "costs": (
            "Costs 1 to 10 along the contexts, budget 30",
            {
                f"{'rising' if rising else 'falling'}, {'' if heeded else 'not '}heeded": (
                    costs,
                    heeded,
                    rising,
                )
                for rising in (True, False)
                for heeded in (True, False)
            },
        ),
        "batches": (
            "Batches, K = 12",
            {f"{size} at a time": (batches, size) for size in (1, 2, 4, 6)},
        ),
    }
    with Pool(mp_context=get_context("spawn")) as pool:
        for title, plays in (tables[part] for part in parts if part in tables):
            table(pool, title, names, plays)
        if "axes" in parts:
            few_targets(pool)
        for part, rule, least in (("stopping", "one", 0.01), ("nothing", "all", 0.005)):
            if part in parts:
                ends(pool, names, rule, least)


def few_targets(pool: Pool) -> None:
    """By number of axes and of targets: regret, error of V, and how often its interval holds it."""
    print(f"\nFew targets, K = {K}\n")
    print("| axes | targets | regret | error of V | V within its 95 % interval |")
    print("|---|---|---|---|---|")
    asked = [(which, n) for which in ("1 axis", "2 axes", "3 axes") for n in (5, 10, 20)]
    runs = [pool.submit(listed, axes, *how) for how in asked]
    for (which, count), run in zip(asked, runs, strict=True):
        left, wrong, inside = np.array(run.result()).T
        held = f"{int(inside.sum())} of {len(inside)}"
        print(
            f"| {which} | {count} | {left.mean():.3f} | {wrong.mean():.3f} | {held} |", flush=True
        )


def listed(play: Callable[..., Iterator[Any]], *how: Any) -> list[Any]:
    return list(play(*how))


def ends(pool: Pool, names: list[str], rule: str, least: float) -> None:
    """Table of a stopping rule."""
    who = "the next one" if rule == "one" else "all left together"
    print(
        f"\nStopping where {who} gain{'s' if rule == 'one' else ''} < {least:g} with 90 %, K = 30\n"
    )
    print(f"| | trainings | {who} gained | regret then |\n|---|---|---|---|")
    for name, run in [(name, pool.submit(ended, name, rule, least)) for name in names]:
        k, gained, left = run.result()
        said = "-" if np.isnan(gained) else f"{gained:.4f}"
        print(f"| {name} | {k:.1f} | {said} | {left:.3f} |", flush=True)


if __name__ == "__main__":
    main()
