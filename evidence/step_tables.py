"""Tables of `steps.py`: what (steps, V) of strategies say, pooled and set by set.

Families count alike, sets within a family alike, and seeds within a set alike.

Notation (shapes): S seeds, E events of a run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from step_measure import BUDGET, StepScale, geometric_mean, paired_interval

from mbtl.zoo.benchmark.shipped import family_of
from mbtl.zoo.benchmark.steps import StepWorld

Array = np.ndarray
Seeds = list[tuple[StepWorld, StepScale]]
Sets = Mapping[str, Seeds]

PAPER = "mbtl, whole, everywhere"
ORACLE = "Sequential Oracle, whole"
CHOSEN = "the best one of the other families"
PICKS = 15


@dataclass(frozen=True)
class Play:
    """What one strategy did on one seed.

    Attributes:
        spent, value: (E,) environment steps, all in, and V.
        lengths: of its trainings, as shares of a whole one.
        evaluation: share of all steps; nan: not known.
        seconds, decisions: of deciding.
    """

    spent: Array
    value: Array
    lengths: Array
    evaluation: float = np.nan
    seconds: float = 0.0
    decisions: float = 1.0

    @staticmethod
    def save(file: Path, plays: Sequence[Play]) -> None:
        """One set's seeds into one file."""
        entries = {
            f"{i} {k}": np.asarray(v) for i, p in enumerate(plays) for k, v in vars(p).items()
        }
        np.savez(file, **entries)

    @classmethod
    def load(cls, file: Path) -> list[Play]:
        """What `save` wrote."""
        with np.load(file) as entries:
            seeds = sorted({int(key.split()[0]) for key in entries.files})
            names = ("spent", "value", "lengths", "evaluation", "seconds", "decisions")
            return [cls(*(entries[f"{i} {name}"] for name in names)) for i in seeds]

    def at(self, steps: float) -> float:
        """V when so many steps are spent; 0 before anything is known."""
        before = int(np.searchsorted(self.spent, steps * (1 + 1e-12), side="right"))
        return float(self.value[before - 1]) if before else 0.0


Plays = Mapping[str, Mapping[str, list[Play]]]
"""Strategy -> set -> a play per seed."""


def with_oracle(sets: Sets, plays: Plays) -> Plays:
    """With the Sequential Oracle of whole trainings, which pays for what it takes alone."""
    found = {}
    for name, seeds in sets.items():
        found[name] = []
        for world, scale in seeds:
            rows = world.episode_steps[-1].sum(axis=1).mean() * world.curves.episodes[0]
            share = rows / (rows + world.training_price[-1].mean())
            whole = np.ones(len(scale.oracle))
            found[name].append(Play(scale.oracle_spent, scale.oracle, whole, share))
    return {**plays, ORACLE: found}


def with_chosen(sets: Sets, plays: Plays) -> Plays:
    """With the strategy that is best by area on the other families, for each family."""
    families = {family_of(name) for name in sets}
    if len(families) < 2:
        return plays
    found = {}
    for family in families:
        others = {n: seeds for n, seeds in sets.items() if family_of(n) != family}
        best = max(plays, key=lambda k, some=others: mean_area(some, plays, k))
        found |= {n: plays[best][n] for n in sets if family_of(n) == family}
    return {**plays, CHOSEN: found}


def mean_area(sets: Sets, plays: Plays, strategy: str) -> float:
    """Over all sets, families alike."""
    areas = {name: area(sets, plays, strategy, name) for name in sets}
    return evenly(sets, lambda n, s: float(areas[n][s]))


def pooled(sets: Sets, of: Callable[[str, int], float]) -> float:
    """Geometric mean over seeds, sets and families of a positive number."""
    parts: dict[str, list[float]] = {}
    for name, seeds in sets.items():
        parts.setdefault(family_of(name), []).append(
            geometric_mean([of(name, s) for s in range(len(seeds))])
        )
    return geometric_mean([geometric_mean(group) for group in parts.values()])


def evenly(sets: Sets, of: Callable[[str, int], float]) -> float:
    """The same as a plain mean."""
    parts: dict[str, list[float]] = {}
    for name, seeds in sets.items():
        parts.setdefault(family_of(name), []).append(
            float(np.mean([of(name, s) for s in range(len(seeds))]))
        )
    return float(np.mean([np.mean(group) for group in parts.values()]))


def to_goal(sets: Sets, plays: Plays, strategy: str, name: str, seed: int) -> float:
    """Steps to V of 15 picks of the paper's MBTL; infinite: not within the budget."""
    level = plays[PAPER][name][seed].value[PICKS - 1]
    play = plays[strategy][name][seed]
    there = np.flatnonzero(play.value >= level - 1e-9)
    return float(play.spent[there[0]]) if len(there) else np.inf


def cheaper(sets: Sets, plays: Plays, strategy: str, *, papers: bool = False) -> tuple[float, bool]:
    """How many times fewer steps than 15 picks of the paper's MBTL; whether a seed missed it.

    With `papers`, than they cost by the paper's protocol.
    """
    missed = False

    def of(name: str, seed: int) -> float:
        nonlocal missed
        scale = sets[name][seed][1]
        steps = to_goal(sets, plays, strategy, name, seed)
        missed = missed or not np.isfinite(steps)
        dear = PICKS * scale.paper if papers else plays[PAPER][name][seed].spent[PICKS - 1]
        return float(dear / min(steps, scale.budget))

    return pooled(sets, of), missed


def area(sets: Sets, plays: Plays, strategy: str, name: str) -> Array:
    """(S,) mean share of the way over the logarithm of steps."""
    both = zip(sets[name], plays[strategy][name], strict=True)
    return np.array([scale.area(play.spent, play.value) for (_, scale), play in both])


def board(sets: Sets, plays: Plays) -> list[str]:
    """Every strategy, pooled."""
    lines = [
        "| strategy | 90 % | 95 % | 99 % | area | area less the paper's MBTL | times cheaper, "
        "prices here | times cheaper, paper's prices | median length | evaluation | ms |",
        "|---" * 11 + "|",
    ]
    areas = {k: {n: area(sets, plays, k, n) for n in sets} for k in plays}
    for strategy in plays:
        cells = [strategy]
        for q in range(3):
            levels = {
                (n, s): scale.to_levels(plays[strategy][n][s].spent, plays[strategy][n][s].value)[q]
                for n, seeds in sets.items() for s, (_, scale) in enumerate(seeds)
            }  # fmt: skip
            mean = pooled(sets, lambda n, s, at=levels: min(at[n, s], BUDGET))
            cells.append(f"{'> ' if np.isinf(list(levels.values())).any() else ''}{mean:.2f}")
        cells.append(f"{evenly(sets, lambda n, s, k=strategy: areas[k][n][s]):.3f}")
        if strategy == PAPER:
            cells.append("-")
        else:
            less = {n: areas[strategy][n] - areas[PAPER][n] for n in sets}
            cells.append("{:+.3f} [{:+.3f}, {:+.3f}]".format(*paired_interval(less)))
        for papers in (False, True):
            times, missed = cheaper(sets, plays, strategy, papers=papers)
            cells.append(f"{'< ' if missed else ''}{times:.1f}")
        every = [play for name in sets for play in plays[strategy][name]]
        cells.append(f"{np.mean([np.median(p.lengths) for p in every]):.2f}")
        evaluation = np.mean([p.evaluation for p in every])
        cells.append(f"{evaluation:.0%}" if np.isfinite(evaluation) else "-")
        decisions = sum(p.decisions for p in every)
        ms = 1e3 * sum(p.seconds for p in every) / decisions
        cells.append(f"{ms:.1f}" if ms else "-")
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def each(sets: Sets, plays: Plays, strategies: Sequence[str], what: str) -> list[str]:
    """A number of some strategies on every set."""
    lines = [f"| {what} | {' | '.join(strategies)} |", "|---" * (len(strategies) + 1) + "|"]
    for name, seeds in sets.items():
        one, cells = {name: seeds}, []
        for strategy in strategies:
            if what == "area":
                cells.append(f"{area(sets, plays, strategy, name).mean():.3f}")
                continue
            both = [cheaper(one, plays, strategy, papers=papers) for papers in (False, True)]
            missed = "< " if both[0][1] else ""
            cells.append(" / ".join(f"{missed}{times:.1f}" for times, _ in both))
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def along(sets: Sets, plays: Plays, strategies: Sequence[str]) -> list[str]:
    """Mean share of the way, by family, when so many units are spent."""
    units = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, BUDGET)
    lines = [
        f"| share of the way after so many units | {' | '.join(f'{u:g}' for u in units)} |",
        "|---" * (1 + len(units)) + "|",
    ]
    for family in sorted({family_of(name) for name in sets}):
        some = {n: seeds for n, seeds in sets.items() if family_of(n) == family}
        for strategy in strategies:

            def share(n: str, s: int, u: float, strategy: str = strategy) -> float:
                scale = sets[n][s][1]
                value = plays[strategy][n][s].at(u * scale.unit)
                return float(np.maximum(scale.share(np.array(value)), 0.0))

            cells = [f"{evenly(some, lambda n, s, u=u, f=share: f(n, s, u)):.2f}" for u in units]
            lines.append(f"| {family}: {strategy} | {' | '.join(cells)} |")
    return lines


def over_oracle(sets: Sets, plays: Plays, strategy: str, name: str) -> Array:
    """(2,) V less the Sequential Oracle's at equal steps, mean over its first 15 trainings.

    First with its evaluations charged, then as if it had none.
    """
    less = np.zeros(2)
    for play, (_, scale) in zip(plays[strategy][name], sets[name], strict=True):
        for i, spent in enumerate((scale.oracle_spent, scale.oracle_trained)):
            mine = [play.at(steps) for steps in spent[:PICKS]]
            less[i] += np.mean(mine - scale.oracle[:PICKS]) / len(sets[name])
    return less


def not_behind(sets: Sets, plays: Plays, strategy: str) -> int:
    """Sets on which a strategy is not behind the Sequential Oracle, all charged."""
    return sum(over_oracle(sets, plays, strategy, name)[0] >= 0 for name in sets)


def against_oracle(sets: Sets, plays: Plays, strategies: Sequence[str]) -> list[str]:
    """That difference on every set."""
    lines = [
        "| V less the Sequential Oracle's, all charged / its evaluations free | "
        + " | ".join(strategies) + " |",
        "|---" * (len(strategies) + 1) + "|",
    ]  # fmt: skip
    found = {k: {name: over_oracle(sets, plays, k, name) for name in sets} for k in strategies}
    for name in sets:
        cells = ["{:+.3f} / {:+.3f}".format(*found[k][name]) for k in strategies]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    above = [np.sum([less >= 0 for less in found[k].values()], axis=0) for k in strategies]
    total = [f"{charged} / {free} of {len(sets)}" for charged, free in above]
    lines.append(f"| sets where it is not behind | {' | '.join(total)} |")
    return lines


def ladder(sets: Sets, plays: Plays, rungs: Mapping[str, str]) -> list[str]:
    """What one saving after the other makes of the steps to the goal, by family.

    After three prices of fifteen picks of the paper's MBTL come `rungs`, title -> strategy.
    """
    families = sorted({family_of(name) for name in sets})
    priced = {
        "fifteen picks by the paper's protocol: 100 episodes on every context": lambda n, s: (
            PICKS * sets[n][s][1].paper
        ),
        "ten episodes": lambda n, s: PICKS * _ten(sets[n][s]),
        "trainings end early": lambda n, s: plays[PAPER][n][s].spent[PICKS - 1],
    }
    lines = [
        "| one after the other | " + " | ".join(f"{f}: units | times" for f in families) + " |",
        "|---" * (1 + 2 * len(families)) + "|",
    ]
    before = dict.fromkeys(families, 0.0)
    for title in (*priced, *rungs):
        cells = []
        for family in families:
            some = {n: seeds for n, seeds in sets.items() if family_of(n) == family}

            def units(n: str, s: int, title: str = title) -> float:
                scale = sets[n][s][1]
                steps = (
                    priced[title](n, s) if title in priced
                    else min(to_goal(sets, plays, rungs[title], n, s), scale.budget)
                )  # fmt: skip
                return float(steps / scale.unit)

            now = pooled(some, units)
            cells += [f"{now:.2f}", f"{before[family] / now:.2f}" if before[family] else "-"]
            before[family] = now
        lines.append(f"| {title} | {' | '.join(cells)} |")
    return lines


def _ten(seed: tuple[StepWorld, StepScale]) -> float:
    """A whole training that is not ended early, and ten episodes on every target."""
    world, _ = seed
    rows = world.episode_steps[-1].sum(axis=1).mean() * world.curves.episodes[0]
    return float(world.lengths[-1] + rows)


def prices(sets: Sets, plays: Plays, strategies: Sequence[str]) -> list[str]:
    """Environment steps that a study needs, in millions, by the share of the way that it goes."""
    lines = [
        "| million steps, all in, to 90 / 95 / 99 % of the way | one whole training | "
        "its evaluation | " + " | ".join(strategies) + " |",
        "|---" * (3 + len(strategies)) + "|",
    ]
    for name, seeds in sets.items():
        rows = [w.episode_steps[-1].sum(axis=1).mean() * w.curves.episodes[0] for w, _ in seeds]
        trained = [w.training_price[-1].mean() for w, _ in seeds]
        cells = [f"{np.mean(trained) / 1e6:.2f}", f"{np.mean(rows) / 1e6:.2f}"]
        for strategy in strategies:
            levels = np.array([
                scale.to_levels(play.spent, play.value)
                for (_, scale), play in zip(seeds, plays[strategy][name], strict=True)
            ])  # fmt: skip
            units = np.array([scale.unit for _, scale in seeds])[:, None]
            found = np.exp(np.log(np.minimum(levels, BUDGET) * units / 1e6).mean(axis=0))
            missed = np.isinf(levels).any(axis=0)
            cells.append(
                " / ".join(
                    f"{'> ' if m else ''}{v:.2f}" for v, m in zip(found, missed, strict=True)
                )
            )
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def constants(title: str, sets: Sets, plays: Plays) -> list[str]:
    """Area of every choice, by family: a family's choice is the best one of the others."""
    families = sorted({family_of(name) for name in sets})
    lines = [f"| {title} | {' | '.join(families)} |", "|---" * (len(families) + 1) + "|"]
    areas = {
        strategy: {
            family: np.mean(
                [area(sets, plays, strategy, n).mean() for n in sets if family_of(n) == family]
            )
            for family in families
        }
        for strategy in plays
    }
    for name, row in areas.items():
        lines.append(f"| {name} | {' | '.join(f'{row[f]:.3f}' for f in families)} |")
    chosen = []
    for family in families:
        others = [f for f in families if f != family]
        best = max(areas, key=lambda n, some=others: np.mean([areas[n][f] for f in some]))
        chosen.append(f"{family}: {best}")
    return [*lines, "", "Chosen without a family: " + "; ".join(chosen), ""]
