"""Results that a change of structure must not change, recorded on one machine and compared there.

    python tools/goldens.py record before/     # about ten minutes of one core
    python tools/goldens.py record after/      # after the change
    python tools/goldens.py compare before/ after/

Recorded are `mbtl bench` on every shipped matrix with the paper's selectors (picks, and V to twelve
digits), quick runs of the six control problems of the paper (transfer rows bit for bit), and all
that `mbtl reproduce` computes. Only commands are used, so that it outlives what is inside. Other
processors round differently, so nothing recorded is kept in the repository.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

SELECTORS = "random,greedy,equidistant,worst-first,mbtl,mbtl-release,mbtl-ei"
PROBLEMS = [
    f"{family}-{axis}"
    for family, axes in {
        "cartpole": ("masscart", "length", "masspole"),
        "pendulum": ("timestep", "length", "mass"),
    }.items()
    for axis in axes
]
DIGITS = 12
VARY = {"select_seconds", "seconds", "command", "wall", "made", "version", "versions", "commit"}
"""Names of what may differ between two runs of one program."""


def mbtl(*words: str) -> str:
    """Standard output of a command."""
    command = [str(Path(sys.executable).with_name("mbtl")), *words]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def record(folder: Path) -> None:
    """Write a file for each golden that is not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    bench = folder / "bench.json"
    if not bench.exists():
        found = mbtl(
            *("bench", "--matrix", "all", "--selectors", SELECTORS),
            *("--budget", "15", "--seeds", "2", "--json"),
        )
        bench.write_text(json.dumps(json.loads(found)["results"], indent=1))
    for problem in PROBLEMS:
        rows = folder / f"{problem}.json"
        if not rows.exists():
            with tempfile.TemporaryDirectory() as place:
                study = str(Path(place) / problem)
                recipe = ("--preset", "quick", "--strategy", "specialists")
                mbtl("run", problem, *recipe, "--study", study)
                mbtl("study", "export", study, f"{place}/rows.json")
                found = json.loads((Path(place) / "rows.json").read_text())["rows"]
            rows.write_text(json.dumps(found, indent=1))
    if not (folder / "reproduction" / "done").exists():
        mbtl("reproduce", "--out", str(folder / "reproduction"))
        (folder / "reproduction" / "done").touch()


def differences(before: Any, after: Any, at: str, exact: bool) -> Iterator[str]:
    """What differs between two JSON documents, by its place in them."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in sorted({*before, *after} - VARY):
            if key not in before or key not in after:
                yield f"{at}.{key}: only {'before' if key in before else 'after'}"
            else:
                yield from differences(before[key], after[key], f"{at}.{key}", exact)
    elif isinstance(before, list) and isinstance(after, list):
        if len(before) != len(after):
            yield f"{at}: {len(before)} entries, then {len(after)}"
        for i, (one, other) in enumerate(zip(before, after, strict=False)):
            yield from differences(one, other, f"{at}[{i}]", exact)
    elif isinstance(before, float) and isinstance(after, float) and not exact:
        if not math.isclose(before, after, rel_tol=10.0**-DIGITS, abs_tol=10.0**-DIGITS):
            yield f"{at}: {before!r}, then {after!r}"
    elif before != after:
        yield f"{at}: {before!r}, then {after!r}"


def compare(before: Path, after: Path) -> int:
    """Print what differs; how many places do."""
    count = 0
    names = {path.relative_to(side) for side in (before, after) for path in side.rglob("*.json")}
    for name in sorted(names):
        if not ((before / name).exists() and (after / name).exists()):
            found = [f"only {'before' if (before / name).exists() else 'after'}"]
        else:
            exact = str(name).removesuffix(".json") in PROBLEMS
            pair = (json.loads((side / name).read_text()) for side in (before, after))
            found = list(differences(*pair, "", exact))
        count += len(found)
        print(f"{name}: {f'{len(found)} differ' if found else 'the same'}")
        for line in found[:5]:
            print(f"  {line}")
    return count


def main() -> None:
    """Record or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["record", "compare"])
    parser.add_argument("folders", type=Path, nargs="+")
    given = parser.parse_args()
    if given.what == "record":
        for folder in given.folders:
            record(folder)
    elif len(given.folders) != 2:
        parser.error("compare needs two folders")
    else:
        raise SystemExit(1 if compare(*given.folders) else 0)


if __name__ == "__main__":
    main()
