"""Transfer data of the small problems, trainings of every kind, and who is best on them.

    python evidence/small_problems.py [--without] [--axes 3] [--ahead specialists]
    python evidence/small_problems.py runs/small --build [--only cart-]

The data stand in evidence/small; the second command builds them anew.

Each is built in one or two minutes of a core. Several processes may build in one folder: what one
has begun the others pass over. Interrupted and begun again, it goes on.

The board: the closed fraction at 1 to 15 units, that is the share of the way from one random
specialist to Oracle Transfer of all specialists, and by how much `auto`, or who is asked for, is
ahead, with its standard error over problems. Twice: the mean of the shares, in which every problem
counts as much; and a ratio of sums, in which it counts as long as its way is. Where that way is
short there is no choice to judge, and the problem is left out.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from regrets import BUDGETS, family_of, table_of, values, variants, world_of

from mbtl.arrays import Array
from mbtl.errors import StorageError
from mbtl.selectors.specialists import Specialists
from mbtl.strategies.auto import Auto
from mbtl.zoo.benchmark.kinds import Kinds
from mbtl.zoo.benchmark.trainings import replay_trainings
from mbtl.zoo.benchmark.transfers import load_transfers, transfer_ids
from mbtl.zoo.small.problems import groups

SMALL = str(Path(__file__).with_name("small"))
LANES = 16
"""Trainings of one program."""
SHOWN = (1, 2, 3, 5, 8, 10, 15)
"""Units of the board."""
SHORT = 0.02
"""Performance between one random specialist and all of them below which there is no way to go."""


def build(folder: Path, only: str, command: str) -> None:
    for seed, some in groups():
        first = some[0].id
        if not first.startswith(only) or (folder / f"{first}-seed{seed}.npz").is_file():
            continue
        trainers = tuple(cmdp.trainer_for() for cmdp in some)
        place = folder / "parts" / first
        kinds = Kinds(tuple(some), trainers, (seed,), place, lanes=LANES, parents=(1.0,))
        begun = time.perf_counter()
        try:
            kinds.run()
        except StorageError as error:  # another process is at it
            print(f"{first}: {error}", file=sys.stderr)
            continue
        files = kinds.save(folder, command, "small")
        took = time.perf_counter() - begun
        print(f"{len(files)} from {first} on: {took / len(files):.0f} s each", flush=True)


def ways(
    name: str, folder: str, strategies: dict[str, Auto], axes: int | None, without: bool
) -> dict[str, Array] | None:
    """(B,) gone from one random specialist, by rival and strategy; None: there is no way to go.

    And "way", how long it is.
    """
    data = load_transfers(name, folder=folder)
    if axes not in (None, len(data.space.axes)):
        return None
    table = table_of(data)
    way = (table.high - table.low).mean()
    if way * len(table.high) < SHORT:
        return None
    rows = dict(table.rivals) | {who: values(s, data, BUDGETS) for who, s in strategies.items()}
    for device in ("lines", "ceilings") if without else ():
        chooser = replace(Specialists(), **{device: False}).without(family_of(name))
        run = replay_trainings(chooser, world_of(data, 0), BUDGETS[-1])
        rows[f"specialists, no {device}"] = np.array([run.at(b) for b in BUDGETS])
    gone = {who: np.mean(np.atleast_2d(v) - table.low[:, None], axis=0) for who, v in rows.items()}
    return gone | {"way": np.array(way)}


def board(folder: str, only: str, without: bool, axes: int | None, first: str) -> None:
    names = [name for name in transfer_ids(folder) if name.startswith(only)]
    strategies = variants() if without else {"auto": Auto()}
    with ProcessPoolExecutor() as pool:
        each = pool.map(
            partial(ways, folder=folder, strategies=strategies, axes=axes, without=without), names
        )
        found = [one for one in each if one is not None]
    at = [BUDGETS.index(units) for units in SHOWN]
    print(f"{len(found)} of {len(names)} problems")
    for title, by_length in (("mean of shares", False), ("ratio of sums", True)):
        print(f"\n| {title} | {' | '.join(map(str, SHOWN))} |")
        print(f"|---|{'---|' * len(SHOWN)}")
        for who in dict.fromkeys(who for one in found for who in one if who != "way"):
            there = [one for one in found if who in one]
            long = np.array([one["way"] for one in there])
            gone, ahead = (np.array([one[k][at] for one in there]) for k in (who, first))
            ahead = ahead - gone
            weights = np.ones(len(long)) / len(long)
            if by_length:
                weights = long / long.sum()
            share, lead = (weights @ (part / long[:, None]) for part in (gone, ahead))
            off = weights[:, None] * (ahead / long[:, None] - lead)
            error = np.sqrt(len(long) / (len(long) - 1) * np.square(off).sum(0))
            cells = [
                f"{mean:.2f}" + ("" if who == first else f" ({more:+.2f} ± {e:.2f})")
                for mean, more, e in zip(share, lead, error, strict=True)
            ]
            print(f"| {who} ({len(there)}) | {' | '.join(cells)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", default=SMALL, help="of the files")
    parser.add_argument("--build", action="store_true", help="build what is missing")
    parser.add_argument("--only", default="", help="problems whose id begins so")
    parser.add_argument("--without", action="store_true", help="leave out each device of auto, too")
    parser.add_argument("--axes", type=int, help="problems of so many axes alone")
    parser.add_argument("--ahead", default="auto", help="whose leads are shown")
    args = parser.parse_args()
    if args.build:
        command = shlex.join(["python", "evidence/small_problems.py", *sys.argv[1:]])
        build(Path(args.folder), args.only, command)
    else:
        board(args.folder, args.only, args.without, args.axes, args.ahead)


if __name__ == "__main__":
    main()
