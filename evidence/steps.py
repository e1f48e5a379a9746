"""The leaderboard over environment steps, all in, on the shipped transfer curves.

    .venv/bin/python evidence/steps.py [--auto] [--write]
    .venv/bin/python evidence/steps.py --constants [--write]
    .venv/bin/python evidence/steps.py --committee [--write]

Every set of curves that is shipped with all its seeds takes part. `--auto` adds the strategies that
ask `auto` (they need most of the time). `--write` puts all tables into docs/appendix/steps.md, and
the sentence and tables of the page into docs/steps.md. `--constants` is about other numbers of the
evaluation and of the pilot instead, and which the other families would have chosen. `--committee`
plays only the committee and the specialists that it has, and writes their table. What was played
is kept in `--keep`, so that it is not played again when a set is added; empty that folder when a
strategy changes.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pages
import step_generalist as generalist
import step_page as page
import step_tables as tables
from step_measure import StepScale
from step_tables import Play, Seeds, Sets

from mbtl.zoo.actions import Committee, Evaluation, FixedLength, Halving, Pilot, Strategy
from mbtl.zoo.actions.evaluation import A_TENTH, WHERE_IT_MATTERS
from mbtl.zoo.benchmark import load_curves
from mbtl.zoo.benchmark.curves import FOLDER
from mbtl.zoo.benchmark.shipped import data_folder, family_of, seed_files
from mbtl.zoo.benchmark.steps import StepWorld, replay_steps

SEEDS = 3
LEAST_ROOM = 0.01
"""V from one random policy to Oracle Transfer: below it shares are noise of the episodes."""
HALVING = {"evaluation": WHERE_IT_MATTERS}

STRATEGIES: tuple[Strategy, ...] = (
    FixedLength("random", name="random, whole, everywhere"),
    FixedLength(None, name="spread, whole, everywhere"),
    FixedLength("mbtl", name=tables.PAPER),
    FixedLength("random", evaluation=WHERE_IT_MATTERS, name="random, whole"),
    FixedLength(None, evaluation=WHERE_IT_MATTERS, name="spread, whole"),
    FixedLength("mbtl", evaluation=WHERE_IT_MATTERS, name="mbtl, whole"),
    FixedLength("mbtl", evaluation=A_TENTH, name="mbtl, whole, evaluation a tenth"),
    FixedLength("mbtl", -2, WHERE_IT_MATTERS, "mbtl, 1/2"),
    FixedLength("random", -3, WHERE_IT_MATTERS, "random, 1/4"),
    FixedLength("equidistant", -3, WHERE_IT_MATTERS, "equidistant, 1/4"),
    FixedLength(None, -3, WHERE_IT_MATTERS, "spread, 1/4"),
    FixedLength("mbtl", -3, WHERE_IT_MATTERS, "mbtl, 1/4"),
    FixedLength("random", -5, WHERE_IT_MATTERS, "random, 1/16"),
    FixedLength(None, -5, WHERE_IT_MATTERS, "spread, 1/16"),
    FixedLength("mbtl", -5, WHERE_IT_MATTERS, "mbtl, 1/16"),
    Halving("own", name="ASHA by own return", **HALVING),
    Halving("mean", name="ASHA by mean", **HALVING),
    Halving("own", first=-5, name="ASHA from 1/16 by own return", **HALVING),
    Halving("mean", first=-5, name="ASHA from 1/16 by mean", **HALVING),
    Halving("own", cohort=16, name="successive halving, 16 by own return", **HALVING),
    Halving("own", brackets=3, name="Hyperband by own return", **HALVING),
    Halving("mean", brackets=3, name="Hyperband by mean", **HALVING),
    Halving("gain", 1, None, 2, name="halving by gain, spread", **HALVING),
    Pilot(selector="random", name="pilot, random"),
    Pilot(selector=None, name="pilot, spread"),
    Pilot(selector="mbtl", name="pilot, mbtl"),
    Pilot(selector="mbtl", evaluation=A_TENTH, name="pilot, mbtl, evaluation a tenth"),
)  # fmt: skip
COMMITTEE = Committee(name=page.COMMITTEE)
"""Played where policies for all contexts were trained; in the leaderboard if that is everywhere."""
WITH_AUTO: tuple[Strategy, ...] = (
    FixedLength("auto", evaluation=A_TENTH, name="auto, whole, evaluation a tenth"),
    Pilot(selector="auto", name="pilot, auto"),
)
CONSTANTS: Mapping[str, Sequence[Strategy]] = {
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


def worlds() -> Sets:
    """Shipped curves by id, where all seeds are there."""
    found: dict[str, Seeds] = {}
    for name, files in sorted(seed_files(data_folder() / FOLDER).items()):
        if len(files) < SEEDS:
            print(f"{name} is left out: it has {len(files)} of {SEEDS} seeds", file=sys.stderr)
            continue
        family, _, rest = name.partition("-")
        axis, _, variant = rest.partition("-")
        curves = load_curves(f"{family}-{axis}", variant or "default")
        made = [
            StepWorld(curves, seed, on_all=generalist.on_all(name, seed))
            for seed in range(curves.n_seeds)
        ]
        seeds = [(world, StepScale.of(world)) for world in made]
        room = np.mean([scale.high - scale.low for _, scale in seeds])
        if room < LEAST_ROOM:
            print(f"{name} is left out: its way is {room:.4f} long", file=sys.stderr)
            continue
        found[name] = seeds
    return found


def played(strategy: Strategy, name: str, seeds: Seeds, keep: Path) -> list[Play]:
    """What a strategy that has not seen the family does on each seed of a set."""
    without = getattr(strategy, "without", None)
    fair = strategy if without is None else without(family_of(name))
    file = keep / f"{name} {strategy.name.replace('/', '_')}.npz"
    if file.is_file():
        return Play.load(file)
    plays, said = [], []
    for world, scale in seeds:
        run = replay_steps(fair, world, scale.budget)
        lengths = np.array([t.steps for t in run.trail.trainings], dtype=float)
        shares = np.array([run.evaluation_share, run.decide_seconds, run.decisions])
        plays.append(Play(run.spent, run.value, lengths / world.lengths[-1], *shares))
        if isinstance(fair, Committee):
            said.append(asdict(generalist.decided(fair, world, run, scale.budget)))
    Play.save(file, plays)
    if said:
        file.with_suffix(".json").write_text(json.dumps(said), encoding="utf-8")
    print(f"{name}: {strategy.name}", file=sys.stderr)
    return plays


def sayings(sets: Sets, keep: Path) -> dict[str, list[generalist.Decided]]:
    """What the committee said on each set; after `played`."""
    files = {name: keep / f"{name} {page.COMMITTEE}.json" for name in sets}
    return {
        name: [generalist.Decided(**one) for one in json.loads(file.read_text(encoding="utf-8"))]
        for name, file in files.items()
    }


def all_played(strategies: Sequence[Strategy], sets: Sets, keep: Path) -> tables.Plays:
    """Strategy -> set -> a play per seed."""
    return {
        strategy.name: {name: played(strategy, name, seeds, keep) for name, seeds in sets.items()}
        for strategy in strategies
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--auto", action="store_true")
    parser.add_argument("--constants", action="store_true")
    parser.add_argument("--committee", action="store_true")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--keep", type=Path, default=Path("runs/steps"))
    args = parser.parse_args()
    args.keep.mkdir(parents=True, exist_ok=True)
    sets = worlds()
    if args.constants:
        lines = []
        for title, grid in CONSTANTS.items():
            lines += tables.constants(title, sets, all_played(grid, sets, args.keep))
        print("\n".join(lines))
        if args.write:
            page.fill("constants", lines)
        return
    tried = {n: seeds for n, seeds in sets.items() if all(world.on_all for world, _ in seeds)}
    if args.committee:
        needed = (COMMITTEE, *(s for s in STRATEGIES if s.name == page.PILOT))
        plays, said = all_played(needed, tried, args.keep), sayings(tried, args.keep)
        lines = page.verdicts(tried, plays, said)
        print("\n".join(lines))
        if args.write:
            page.fill("committee", lines)
        return
    strategies = STRATEGIES + (WITH_AUTO if args.auto else ())
    plays = tables.with_chosen(sets, all_played(strategies, sets, args.keep))
    beside = all_played([COMMITTEE], tried, args.keep)
    if tried.keys() == sets.keys():
        plays |= beside
    plays = {
        **plays,
        page.ALONE: generalist.alone(sets),
        page.RACE: generalist.race(sets, plays, page.OURS),
    }
    plays = tables.with_oracle(sets, plays)
    found = page.verdicts(tried, {**plays, **beside}, sayings(tried, args.keep))
    lines = page.everything(sets, plays, found)
    print("\n".join(lines))
    if args.write:
        pages.write_appendix("steps", "Count steps: all tables", "steps.md", lines)
        page.write(sets, plays, found)


if __name__ == "__main__":
    main()
