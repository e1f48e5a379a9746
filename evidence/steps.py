"""The leaderboard over environment steps, all in, on the shipped transfer curves.

    .venv/bin/python evidence/steps.py [--auto] [--write]
    .venv/bin/python evidence/steps.py --constants [--write]

`--auto` adds the strategies that ask `auto` (they need most of the time). `--constants` prints
instead what other numbers of the evaluation and of the pilot are worth on each family, and which
would have been chosen by the other families alone. `--write` puts the tables into docs/steps.md.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbtl.actions import Evaluation, FixedLength, Halving, Pilot
from mbtl.actions.evaluation import WHERE_IT_MATTERS
from mbtl.benchmark import load_curves
from mbtl.benchmark.curves import FOLDER
from mbtl.benchmark.shipped import data_folder, family_of, seed_files
from mbtl.benchmark.step_measure import BUDGET, StepScale, geometric_mean, paired_interval
from mbtl.benchmark.steps import StepRun, StepWorld, replay_steps

FILE = Path(__file__).parents[1] / "docs/steps.md"
MARKS = "<!-- begin: evidence/steps.py {} -->", "<!-- end -->"
LEAST_ROOM = 0.01
"""V from one random policy to Oracle Transfer: below it shares are noise of the episodes."""
PAPER = "mbtl, whole, everywhere"
PICKS = 15
ORACLE = "Sequential Oracle, whole"

STRATEGIES = (
    FixedLength("random", name="random, whole, everywhere"),
    FixedLength(None, name="spread, whole, everywhere"),
    FixedLength("mbtl", name=PAPER),
    FixedLength("random", evaluation=WHERE_IT_MATTERS, name="random, whole"),
    FixedLength(None, evaluation=WHERE_IT_MATTERS, name="spread, whole"),
    FixedLength("mbtl", evaluation=WHERE_IT_MATTERS, name="mbtl, whole"),
    FixedLength("mbtl", -2, WHERE_IT_MATTERS, "mbtl, 1/2"),
    FixedLength("random", -3, WHERE_IT_MATTERS, "random, 1/4"),
    FixedLength(None, -3, WHERE_IT_MATTERS, "spread, 1/4"),
    FixedLength("mbtl", -3, WHERE_IT_MATTERS, "mbtl, 1/4"),
    Halving("own", 2, "random", 2, WHERE_IT_MATTERS, "ASHA by own return"),
    Halving("mean", 2, "random", 2, WHERE_IT_MATTERS, "ASHA by mean"),
    Halving("gain", 1, None, 2, WHERE_IT_MATTERS, "halving by gain, spread"),
    Pilot(selector=None, name="pilot, spread"),
    Pilot(selector="mbtl", name="pilot, mbtl"),
)
WITH_AUTO = (
    FixedLength("auto", evaluation=WHERE_IT_MATTERS, name="auto, whole"),
    Pilot(selector="auto", name="pilot, auto"),
)
CONSTANTS = {
    "targets evaluated first, and margin": tuple(
        FixedLength(None, evaluation=Evaluation(count, margin=margin), name=f"{count}, {margin}")
        for count in (3, 5, 8, 12)
        for margin in (0.0, 0.05)
    ),
    "pilot: enough, and one of so many goes on": tuple(
        Pilot(enough, promote, name=f"{enough}, {promote}")
        for enough in (0.7, 0.8, 0.9)
        for promote in (2, 4)
    ),
}

Seeds = list[tuple[StepWorld, StepScale]]
Goal = tuple[float, float, float]


@dataclass(frozen=True)
class Result:
    """One strategy on one set, an entry per seed."""

    levels: np.ndarray  # (S, 3) units to 90, 95, 99 %; infinite: not reached
    area: np.ndarray
    faster: np.ndarray  # (S,) than 15 picks of the paper's MBTL at the prices here
    paper: np.ndarray  # the same at the prices of the paper's protocol
    evaluation: float
    seconds: float
    decisions: int


def worlds() -> dict[str, Seeds]:
    """Shipped curves by id."""
    found = {}
    for name in sorted(seed_files(data_folder() / FOLDER)):
        family, _, rest = name.partition("-")
        axis, _, variant = rest.partition("-")
        curves = load_curves(f"{family}-{axis}", variant or "default")
        made = [StepWorld(curves, seed) for seed in range(curves.n_seeds)]
        found[name] = [(world, StepScale.of(world)) for world in made]
    room = {name: np.mean([s.high - s.low for _, s in seeds]) for name, seeds in found.items()}
    for name in [name for name in found if room[name] < LEAST_ROOM]:
        print(f"{name} is left out: its way is {room[name]:.4f} long", file=sys.stderr)
        del found[name]
    return found


def goal(run: StepRun, scale: StepScale) -> Goal:
    """V of 15 picks of the paper's MBTL, what they cost here, and by the paper's protocol."""
    return float(run.value[PICKS - 1]), float(run.spent[PICKS - 1]), PICKS * scale.paper


def measured(
    curves: Sequence[tuple[np.ndarray, np.ndarray]], seeds: Seeds, goals: Sequence[Goal]
) -> dict[str, np.ndarray]:
    """What (steps, V) of every seed say; ratios are negative where the goal was not reached."""
    faster, paper = [], []
    for (spent, value), (_, scale), (level, cost, dear) in zip(curves, seeds, goals, strict=True):
        there = np.flatnonzero(value >= level - 1e-9)
        steps = spent[there[0]] if len(there) else -scale.budget
        faster.append(cost / steps)
        paper.append(dear / steps)
    both = [(scale, *curve) for curve, (_, scale) in zip(curves, seeds, strict=True)]
    return {
        "levels": np.array([scale.to_levels(spent, value) for scale, spent, value in both]),
        "area": np.array([scale.area(spent, value) for scale, spent, value in both]),
        "faster": np.array(faster),
        "paper": np.array(paper),
    }


def result(
    strategy: FixedLength | Halving | Pilot, name: str, seeds: Seeds, goals: Sequence[Goal]
) -> Result:
    runs = played(strategy, name, seeds)
    return Result(
        **measured([(run.spent, run.value) for run in runs], seeds, goals),
        evaluation=float(np.mean([run.evaluation_share for run in runs])),
        seconds=sum(run.decide_seconds for run in runs),
        decisions=sum(run.decisions for run in runs),
    )


def oracle_result(seeds: Seeds, goals: Sequence[Goal]) -> Result:
    shares = []
    for world, _ in seeds:
        price = world.episode_steps[-1].sum(axis=1).mean() * world.curves.episodes[0]
        shares.append(price / (price + world.training_price[-1].mean()))
    curves = [(scale.oracle_spent, scale.oracle) for _, scale in seeds]
    return Result(
        **measured(curves, seeds, goals),
        evaluation=float(np.mean(shares)), seconds=0.0, decisions=1,
    )  # fmt: skip


def played(strategy: FixedLength | Halving | Pilot, name: str, seeds: Seeds) -> list[StepRun]:
    fair = strategy.without(family_of(name))
    return [replay_steps(fair, world, scale.budget) for world, scale in seeds]


def by_family(results: Mapping[str, Result]) -> dict[str, list[Result]]:
    families: dict[str, list[Result]] = {}
    for name, result in results.items():
        families.setdefault(family_of(name), []).append(result)
    return families


def pooled_levels(results: Mapping[str, Result]) -> list[str]:
    """Units to each level: geometric means over seeds and sets, then over families."""
    cells = []
    for q in range(3):
        parts = [
            geometric_mean(np.concatenate([np.minimum(r.levels[:, q], BUDGET) for r in group]))
            for group in by_family(results).values()
        ]
        some = any(np.isinf(r.levels[:, q]).any() for r in results.values())
        cells.append(f"{'> ' if some else ''}{geometric_mean(parts):.2f}")
    return cells


def speed(groups: Sequence[Sequence[np.ndarray]]) -> str:
    """Families pooled evenly; negative marks a seed that did not get there."""
    parts = [geometric_mean(np.abs(np.concatenate(group))) for group in groups]
    missed = any((values < 0).any() for group in groups for values in group)
    return f"{'< ' if missed else ''}{geometric_mean(parts):.1f}"


def board(found: Mapping[str, Mapping[str, Result]], oracle: Mapping[str, Result]) -> list[str]:
    lines = [
        "| strategy | 90 % | 95 % | 99 % | area | area less the paper's MBTL | times cheaper, "
        "prices here | times cheaper, paper's prices | evaluation | ms per decision |",
        "|---" * 10 + "|",
    ]
    for name, results in {**found, ORACLE: oracle}.items():
        families = by_family(results)
        area = np.mean([np.mean([r.area.mean() for r in g]) for g in families.values()])
        less = {n: results[n].area - found[PAPER][n].area for n in results}
        mean, low, high = paired_interval(less)
        cells = [name, *pooled_levels(results), f"{area:.3f}"]
        cells.append("-" if name == PAPER else f"{mean:+.3f} [{low:+.3f}, {high:+.3f}]")
        cells.append(speed([[r.faster for r in g] for g in families.values()]))
        cells.append(speed([[r.paper for r in g] for g in families.values()]))
        cells.append(f"{np.mean([r.evaluation for r in results.values()]):.0%}")
        ms = sum(r.seconds for r in results.values()) / sum(r.decisions for r in results.values())
        cells.append("-" if name == ORACLE else f"{1e3 * ms:.1f}")
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def each(
    found: Mapping[str, Mapping[str, Result]],
    oracle: Mapping[str, Result],
    names: Sequence[str],
    what: str,
) -> list[str]:
    every = {**found, ORACLE: oracle}
    lines = [f"| {what} | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for world in found[PAPER]:
        results = [every[name][world] for name in names]
        if what == "area":
            cells = [f"{r.area.mean():.3f}" for r in results]
        elif what == "95 %":
            cells = [
                f"{'> ' if np.isinf(r.levels[:, 1]).any() else ''}"
                f"{geometric_mean(np.minimum(r.levels[:, 1], BUDGET)):.2f}"
                for r in results
            ]
        else:
            cells = [f"{speed([[r.faster]])} / {speed([[r.paper]])}" for r in results]
        lines.append(f"| {world} | {' | '.join(cells)} |")
    return lines


def constants(sets: Mapping[str, Seeds]) -> list[str]:
    """Area of every choice, by family: a family's choice is the best one of the others."""
    lines = []
    families = sorted({family_of(name) for name in sets})
    for title, grid in CONSTANTS.items():
        lines += [f"| {title} | {' | '.join(families)} |", "|---" * (len(families) + 1) + "|"]
        areas = {}
        for strategy in grid:
            print(title, strategy.name, file=sys.stderr)
            areas[strategy.name] = {
                family: np.mean([
                    np.mean([
                        scale.area(run.spent, run.value)
                        for run, (_, scale) in zip(played(strategy, n, s), s, strict=True)
                    ])
                    for n, s in sets.items() if family_of(n) == family
                ])
                for family in families
            }  # fmt: skip
        for name, row in areas.items():
            lines.append(f"| {name} | {' | '.join(f'{row[f]:.3f}' for f in families)} |")
        chosen = {
            family: max(
                areas, key=lambda n: np.mean([areas[n][f] for f in families if f != family])
            )
            for family in families
        }
        lines += [
            "",
            "Chosen without a family: " + "; ".join(f"{f}: {c}" for f, c in chosen.items()),
            "",
        ]
    return lines


def boards(sets: Mapping[str, Seeds], auto: bool) -> list[str]:
    """The pooled table, and three that show every set."""
    strategies = STRATEGIES + (WITH_AUTO if auto else ())
    goals: dict[str, list[Goal]] = {}
    reference = next(s for s in STRATEGIES if s.name == PAPER)
    for name, seeds in sets.items():
        runs = played(reference, name, seeds)
        goals[name] = [goal(run, scale) for run, (_, scale) in zip(runs, seeds, strict=True)]
    found: dict[str, dict[str, Result]] = {}
    for strategy in strategies:
        begun = time.perf_counter()
        found[strategy.name] = {
            name: result(strategy, name, seeds, goals[name]) for name, seeds in sets.items()
        }
        print(f"{strategy.name}: {time.perf_counter() - begun:.0f} s", file=sys.stderr)
    oracle = {n: oracle_result(s, goals[n]) for n, s in sets.items()}
    shown = [PAPER, "spread, whole", "mbtl, whole", "mbtl, 1/2", "pilot, spread", "pilot, mbtl"]
    shown += [s.name for s in WITH_AUTO] if auto else []
    shown += [ORACLE]
    lines = [f"{len(sets)} sets, three seeds each, {BUDGET:.0f} units", ""]
    lines += [*board(found, oracle), ""]
    for family in sorted({family_of(name) for name in sets}):
        some = {k: {n: r for n, r in v.items() if family_of(n) == family} for k, v in found.items()}
        theirs = {n: r for n, r in oracle.items() if family_of(n) == family}
        lines += [f"{family} alone", "", *board(some, theirs), ""]
    for what in ("times cheaper, prices here / paper's", "area", "95 %"):
        lines += [*each(found, oracle, shown, what), ""]
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--auto", action="store_true")
    parser.add_argument("--constants", action="store_true")
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    sets = worlds()
    lines = constants(sets) if args.constants else boards(sets, args.auto)
    print("\n".join(lines))
    if args.write:
        begin, end = MARKS[0].format("--constants" if args.constants else "--write"), MARKS[1]
        head, rest = FILE.read_text(encoding="utf-8").split(begin)
        tail = rest.split(end, 1)[1]
        FILE.write_text(head + "\n".join([begin, "", *lines, end]) + tail, encoding="utf-8")


if __name__ == "__main__":
    main()
