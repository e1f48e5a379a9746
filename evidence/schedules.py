"""How the learning rate should go in a training whose length nobody knows.

One policy for all contexts, extended from mark to mark; V of all contexts by fresh episodes, mean
over seeds, and the deviation between seeds. Ways:

    anew       the rate falls to zero at each mark and begins anew
    whole      it falls once, over a length that is known (a training of its own for each mark)
    T/S        as one over sqrt(1 + units / T), inf: constant; a branch of the share S of what is
               paid from mark to mark leaves the trunk, along which it falls to zero

    python evidence/schedules.py pendulum-mass pendulum-timestep --ways anew whole inf/.2 .1/.2
"""

from __future__ import annotations

import argparse

import numpy as np

import mbtl.engine.learners  # noqa: F401  isort: skip  # first: flags of jax
import jax
import jax.numpy as jnp

from mbtl.engine.learners.clock import Pace
from mbtl.problems import get_cmdp
from mbtl.seeds import MATRIX_TRIAL, Purpose, evaluation_seeds, training_seed


def policies(trainer, contexts, seeds, marks, way):
    """Mark -> P policies, one per seed."""
    growing = trainer._growing([contexts] * len(seeds), seeds)
    unit = growing.recipe.update_length
    ends = [trainer._updates(mark, unit) for mark in marks]
    found, done = {}, 0
    if way in ("anew", "whole"):
        training = growing.start()
        for mark, end in zip(marks, ends, strict=True):
            if way == "whole":
                training, done = growing.start(), 0
            pace = Pace.endless(growing.whole).branch(done, end)
            training = growing._learn(training, end, pace, None)
            found[mark], done = growing.policies(training.state.weights), end
        return found
    slowing, share = map(float, way.split("/"))
    training, trunk = growing.start(), Pace.endless(growing.whole, slowing * growing.whole)
    for mark, end in zip(marks, ends, strict=True):
        branch = round(share * (end - done))
        leaves = int(training.updates) + end - done - branch  # what was a branch is paid, and gone
        training = growing._learn(training, leaves, trunk, None)
        copy, pace = jax.tree.map(jnp.copy, training), trunk.branch(leaves, leaves + max(branch, 1))
        ended = growing._learn(copy, leaves + branch, pace, None)
        found[mark], done = growing.policies(ended.state.weights), end
    return found


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("cmdps", nargs="+")
    parser.add_argument("--ways", nargs="+", default=["anew", "whole", "inf/.2", ".1/.2"])
    parser.add_argument("--marks", nargs="+", type=float, default=[0.25, 0.5, 1, 2, 4])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--every", type=int, default=5, help="every n-th context as a target")
    options = parser.parse_args()
    roots = range(options.seeds)
    for name in options.cmdps:
        cmdp = get_cmdp(name)
        trainer = cmdp.trainer_for(None, eval_episodes=options.episodes)
        contexts, n = list(cmdp.space.contexts), cmdp.space.n
        targets = range(0, n, options.every)
        own = [training_seed(root, MATRIX_TRIAL, range(n)) for root in roots]
        print(f"{name:20s}" + "".join(f"{mark:>14g}" for mark in options.marks), flush=True)
        for way in options.ways:
            each = []
            for _, some in policies(trainer, contexts, own, options.marks, way).items():
                v = []
                for root, policy in zip(roots, some, strict=True):
                    seeds = evaluation_seeds(root, MATRIX_TRIAL, targets, Purpose.REPORT)
                    returns = trainer.evaluate(policy, [contexts[t] for t in targets], seeds)
                    v.append(cmdp.normalisation.normalise(returns.mean(axis=1)).mean())
                each.append((np.mean(v), np.std(v, ddof=min(1, len(v) - 1))))
            print(f"  {way:18s}" + "".join(f"{m:8.3f} ±{s:4.2f}" for m, s in each), flush=True)


if __name__ == "__main__":
    main()
