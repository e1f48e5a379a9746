"""How wide should the layers of a policy for all contexts be, and of specialists?

    python evidence/widths.py cheetah-friction --widths 64 128 256 --until 2   # an hour of a core
    python evidence/widths.py cheetah-friction --alone                         # ten minutes

Printed are performances, a line for each width. Of one policy for all at each length, in units: the
mean over all contexts, three seeds. With `--alone`, of five specialists: at home each, and V of the
five. Our recipe has the double width of specialists for one policy for all (docs/decisions.md).
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import numpy as np

import mbtl
from mbtl.objective import Bounds
from mbtl.seeds import MATRIX_TRIAL, evaluation_seeds, training_seed
from mbtl.zoo.benchmark.kinds import GENERALIST_UNITS

SEEDS = range(3)
EPISODES = 2
"""Of each policy in each context."""


def performances(cmdp: mbtl.CMDP, trainer: Any, policies: list[Any]) -> np.ndarray:
    """(P, N) of policies in all contexts."""
    seeds = evaluation_seeds(0, MATRIX_TRIAL, range(cmdp.space.n))
    returns = trainer.evaluate_many(policies, cmdp.space.contexts, seeds).mean(axis=-1)
    assert cmdp.bounds is not None
    return Bounds(*cmdp.bounds).normalise(returns)


def for_all(cmdp: mbtl.CMDP, trainer: Any, until: float) -> None:
    """One policy for all contexts, at every mark."""
    everybody = range(cmdp.space.n)
    seeds = [training_seed(seed, MATRIX_TRIAL, everybody) for seed in SEEDS]
    marks = [mark for mark in GENERALIST_UNITS if mark <= until]
    grown = trainer.grow_many([cmdp.space.contexts] * len(seeds), seeds, marks)
    for mark, policies, _ in grown:
        each = performances(cmdp, trainer, policies).mean(axis=1)
        rows = " ".join(f"{x:.3f}" for x in each)
        print(f"  {mark:5g} units  {each.mean():.3f}   {rows}", flush=True)


def alone(cmdp: mbtl.CMDP, trainer: Any) -> None:
    """Five specialists of one unit."""
    sources = range(cmdp.space.n // 20, cmdp.space.n, cmdp.space.n // 5)
    contexts = [cmdp.space.contexts[source] for source in sources]
    seeds = [training_seed(0, MATRIX_TRIAL, source) for source in sources]
    found = performances(cmdp, trainer, trainer.train_many(contexts, seeds, keep=("best",))["best"])
    home = found[np.arange(len(sources)), list(sources)]
    rows = " ".join(f"{x:.3f}" for x in home)
    print(
        f"  at home {home.mean():.3f}   {rows}; V of all {found.max(axis=0).mean():.3f}", flush=True
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cmdp", help="of a walker or a cheetah: the others have their own recipe")
    parser.add_argument("--widths", type=int, nargs="+", default=[64, 128], help="even numbers")
    parser.add_argument("--until", type=float, default=1.0, help="units of one policy for all")
    parser.add_argument("--alone", action="store_true", help="specialists instead")
    args = parser.parse_args()
    if any(width % 2 for width in args.widths):
        parser.error("--widths must be even")
    cmdp = mbtl.get_cmdp(args.cmdp)
    usual: Any = cmdp.trainer_for()
    for width in args.widths:
        print(f"{cmdp.id}, two layers of {width}", flush=True)
        hidden = (width if args.alone else width // 2,) * 2
        own = {**usual.hyperparameters, "hidden": hidden}
        trainer = replace(usual, hyperparameters=own, eval_episodes=EPISODES)
        if args.alone:
            alone(cmdp, trainer)
        else:
            for_all(cmdp, trainer, args.until)


if __name__ == "__main__":
    main()
