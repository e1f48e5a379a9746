"""Transfer data of the small problems, trainings of every kind, and who is best on them.

    python evidence/small_problems.py runs/small --build [--only cart-]
    python evidence/small_problems.py runs/small [--without]

Each is built in one or two minutes of a core. Several processes may build in one folder: what one
has begun the others pass over. Interrupted and begun again, it goes on.

The board: the closed fraction at 1 to 15 units, that is the share of the way from one random
specialist to Oracle Transfer of all specialists, mean over problems, and by how much `auto` is
ahead, problem by problem, with the standard error. Where that way is short there is no choice to
judge, and the problem is left out.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from regrets import BUDGETS, table_of, values, variants

from mbtl.arrays import Array
from mbtl.errors import StorageError
from mbtl.strategies.auto import Auto
from mbtl.zoo.benchmark.kinds import Kinds
from mbtl.zoo.benchmark.transfers import load_transfers, transfer_ids
from mbtl.zoo.small.problems import groups

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


def shares(name: str, folder: str, strategies: dict[str, Auto]) -> dict[str, Array] | None:
    """(B,) closed fraction of every rival and strategy on one problem; None: there is no way."""
    data = load_transfers(name, folder=folder)
    table = table_of(data)
    if (table.high - table.low).sum() < SHORT:
        return None
    found = {who: table.share(rows) for who, rows in table.rivals.items()}
    return found | {who: table.share(values(one, data, BUDGETS)) for who, one in strategies.items()}


def board(folder: str, only: str, without: bool) -> None:
    names = [name for name in transfer_ids(folder) if name.startswith(only)]
    strategies = variants() if without else {"auto": Auto()}
    with ProcessPoolExecutor() as pool:
        each = pool.map(partial(shares, folder=folder, strategies=strategies), names)
        found = {name: one for name, one in zip(names, each, strict=True) if one is not None}
    at = [BUDGETS.index(units) for units in SHOWN]
    print(f"{len(found)} of {len(names)} problems\n")
    print(f"| closed fraction | {' | '.join(map(str, SHOWN))} |")
    print(f"|---|{'---|' * len(SHOWN)}")
    for who in dict.fromkeys(who for one in found.values() for who in one):
        there = [name for name, one in found.items() if who in one]
        own = np.array([found[name][who][at] for name in there])
        lead = np.array([found[name]["auto"][at] for name in there]) - own
        error = lead.std(0, ddof=1) / np.sqrt(len(there))
        cells = [
            f"{mean:.2f}" + ("" if who == "auto" else f" ({ahead:+.2f} ± {e:.2f})")
            for mean, ahead, e in zip(own.mean(0), lead.mean(0), error, strict=True)
        ]
        print(f"| {who} ({len(there)}) | {' | '.join(cells)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", help="of the files")
    parser.add_argument("--build", action="store_true", help="build what is missing")
    parser.add_argument("--only", default="", help="problems whose id begins so")
    parser.add_argument("--without", action="store_true", help="leave out each device of auto, too")
    args = parser.parse_args()
    if args.build:
        command = shlex.join(["python", "evidence/small_problems.py", *sys.argv[1:]])
        build(Path(args.folder), args.only, command)
    else:
        board(args.folder, args.only, args.without)


if __name__ == "__main__":
    main()
