"""Transfer data of the small problems: trainings of every kind, one seed each.

    python evidence/small_problems.py --build runs/small [--only cart-]
    python evidence/regrets.py --folder runs/small

Each is built in one or two minutes of a core. Several processes may build in one folder: what one
has begun the others pass over. Interrupted and begun again, it goes on.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from pathlib import Path

from mbtl.errors import StorageError
from mbtl.zoo.benchmark.kinds import Kinds
from mbtl.zoo.small.problems import groups

LANES = 16
"""Trainings of one program."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--build", type=Path, required=True, help="folder of the files")
    parser.add_argument("--only", default="", help="problems whose id begins so")
    args = parser.parse_args()
    command = shlex.join(["python", "evidence/small_problems.py", *sys.argv[1:]])
    for seed, some in groups():
        first = some[0].id
        if not first.startswith(args.only) or (args.build / f"{first}-seed{seed}.npz").is_file():
            continue
        trainers = tuple(cmdp.trainer_for() for cmdp in some)
        place = args.build / "parts" / first
        kinds = Kinds(tuple(some), trainers, (seed,), place, lanes=LANES, parents=(1.0,))
        begun = time.perf_counter()
        try:
            kinds.run()
        except StorageError as error:  # another process is at it
            print(f"{first}: {error}", file=sys.stderr)
            continue
        files = kinds.save(args.build, command, "small")
        took = time.perf_counter() - begun
        print(f"{len(files)} from {first} on: {took / len(files):.0f} s each", flush=True)


if __name__ == "__main__":
    main()
