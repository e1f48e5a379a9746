"""Which features of CARL's environments act on the dynamics? `check_cmdp` on each of them.

Each numeric feature is varied alone, to 0.8 and 1.25 times its default value (a tenth of its range
around a default of 0, as far as the range allows), other features at their defaults. "acts": two of
its values give different rollouts under the same seed and random actions. Needs an environment with
CARL (docs/carl.md); the table is in Markdown.

example: python benchmarks/carl_check.py --environments CARLCartPole CARLBipedalWalker
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
    "CARLBipedalWalker", "CARLLunarLander", "CARLDmcWalkerEnv",
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

    print("| environment | feature | values | acts | other findings |\n|---|---|---|---|---|")
    for environment in args.environments:
        for name, (low, high, default) in carl_features(environment).items():
            tried = values(low, high, float(default))
            space = carl_space(environment, {name: tried})
            report = check_cmdp(CarlFactory(environment), space, steps=args.steps)
            found = {check.name: check for check in report.checks}
            acts = found.get(f"axis {name!r} acts on the dynamics")
            others = [
                f"{check.name}: {check.detail[:90]}"
                for check in report.failures
                if check is not acts
            ]
            word = "?" if acts is None else {"passed": "yes", "failed": "no"}.get(acts.outcome, "?")
            shown = ", ".join(f"{x:g}" for x in tried)
            print(
                f"| {environment.removeprefix('CARL')} | {name} | {shown} | {word} | "
                f"{'; '.join(others).replace('|', '/')} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
