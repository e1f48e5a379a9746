"""Time of `import mbtl` in a fresh interpreter, against `import numpy` and `import sklearn`.

Each import runs in its own new process, in turn, best of 5; the start of the interpreter is not
counted. Also printed: which heavy packages `import mbtl` has loaded.

example: python benchmarks/import_time.py
"""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import measure
from measure import digits

GOAL_SECONDS = 1.0
IMPORTS = ("numpy", "sklearn", "mbtl")
HEAVY = ("torch", "jax", "sklearn", "gymnasium", "matplotlib", "stable_baselines3")
CHILD = """
import json, sys, time
start = time.perf_counter()
import {name}
seconds = time.perf_counter() - start
print(json.dumps([seconds, [name for name in {heavy} if name in sys.modules], len(sys.modules)]))
"""


def fresh_import(name: str) -> tuple[float, list[str], int]:
    """Seconds of an import in a new interpreter, the heavy packages and modules it loaded."""
    code = CHILD.format(name=name, heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    seconds, heavy, modules = json.loads(done.stdout)
    return seconds, heavy, modules


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--repeats", type=int, default=5, help="imports of each package; the best")
    args = parser.parse_args()
    runs = [{name: fresh_import(name) for name in IMPORTS} for _ in range(args.repeats)]
    best = {name: min(run[name][0] for run in runs) for name in IMPORTS}
    _, heavy, modules = runs[0]["mbtl"]
    document: dict[str, Any] = {
        "seconds": {name: digits(seconds) for name, seconds in best.items()},
        "ratio_to_numpy": digits(best["mbtl"] / best["numpy"], 3),
        "ratio_to_sklearn": digits(best["mbtl"] / best["sklearn"], 3),
        "heavy_loaded": {name: name in heavy for name in HEAVY},
        "modules": modules,
        "goal_seconds": GOAL_SECONDS,
        "goal_met": best["mbtl"] <= GOAL_SECONDS,
        "machine": measure.machine("scikit-learn"),
    }
    lines = [
        f"import mbtl {best['mbtl']:.3f} s (best of {args.repeats}): "
        f"{best['mbtl'] / best['numpy']:.2f} x numpy ({best['numpy']:.3f} s), "
        f"{best['mbtl'] / best['sklearn']:.2f} x sklearn ({best['sklearn']:.3f} s); "
        f"goal {GOAL_SECONDS:g} s",
        f"{modules} modules; heavy packages loaded by it: {', '.join(heavy) or 'none'} "
        f"(looked for {', '.join(HEAVY)})",
    ]
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
