"""Which features of CARL's environments act on the dynamics? `check_cmdp` on each of them.

Each numeric feature is varied alone, to 0.8 and 1.25 times its default value (a tenth of its range
around a default of 0, as far as the range allows), other features at their defaults. "acts": two of
its values give different rollouts under the same seed and random actions. "Contexts leak": an
episode differs from the same one alone while, or after, another context is simulated. Needs an
environment with CARL (docs/carl.md); the table is in Markdown.

example: python evidence/carl_check.py --environments CARLCartPole CARLBipedalWalker
"""

from __future__ import annotations

import argparse
import math
import os
import warnings

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("PYTHONWARNINGS", "ignore")
warnings.simplefilter("ignore")

ENVIRONMENTS = (
    "CARLCartPole", "CARLPendulum", "CARLAcrobot", "CARLMountainCar", "CARLMountainCarContinuous",
    "CARLBipedalWalker", "CARLLunarLander",
)  # fmt: skip


def values(low: float, high: float, default: float) -> list[float]:
    """Two or three values around the default, within the range."""
    if default:
        around = sorted([0.8 * default, default, 1.25 * default])
    else:
        span = (high - low) / 10 if math.isfinite(high - low) else 1.0
        around = [-span, 0.0, span]
    whole = float(default).is_integer() and abs(default) >= 100
    kept = {min(max(round(x) if whole else x, low), high) for x in around}
    return sorted(kept)


def main() -> None:
    """Check and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--environments", nargs="+", default=list(ENVIRONMENTS))
    parser.add_argument("--steps", type=int, default=200)
    args = parser.parse_args()
    from mbtl.cmdps import check_cmdp
    from mbtl.cmdps.carl import CarlFactory, carl_features, carl_space

    heads = ("environment", "acts", "does not", "contexts leak in", "other findings")
    print(f"| {' | '.join(heads)} |\n" + "|---" * len(heads) + "|")
    for environment in args.environments:
        acting, dead, leaking, others = [], [], [], {}
        for name, (low, high, default) in carl_features(environment).items():
            space = carl_space(environment, {name: values(low, high, float(default))})
            report = check_cmdp(CarlFactory(environment), space, steps=args.steps)
            for check in report.checks:
                if check.name.startswith("axis"):
                    (acting if check.ok else dead).append(name)
                elif check.name == "contexts do not leak" and "differs" in check.detail:
                    leaking.append(name)
                elif not check.ok:
                    finding = f"{check.name}: {check.detail}".partition(" at {")[0]
                    others.setdefault(finding[:120], []).append(name)
        cells = [", ".join(names) or "-" for names in (acting, dead, leaking)]
        every = len(carl_features(environment))
        found = [
            f"{finding} ({'all' if len(names) == every else ', '.join(names)})"
            for finding, names in others.items()
        ]
        row = [environment.removeprefix("CARL"), *cells, "; ".join(found) or "-"]
        print("| " + " | ".join(cell.replace("|", "/") for cell in row) + " |", flush=True)


if __name__ == "__main__":
    main()
