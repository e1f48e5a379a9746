"""Evaluation of many policies on many contexts, against one Gymnasium environment after another.

    .venv/bin/python benchmarks/jax_evaluation.py

Ours: policies x 100 contexts x 100 deterministic episodes of CartPole, as in a transfer matrix, one
thread. The peer: the same policy in numpy, the environments stepped in lockstep (what a study does
without jax). Rates count the steps that episodes really took, in processor time, and are given per
core as steps, and as episodes of 500 steps; beside them the share of the float32 matrix-multiply
rate that the actor's products alone account for.
"""

from __future__ import annotations

import measure  # noqa: F401  first: threads

import time  # isort: skip

from jax_throughput import peak


def main() -> None:
    from mbtl.problems import get_cmdp

    cmdp = get_cmdp("cartpole-length", engine="jax")
    trainer = cmdp.trainer_for("quick", timesteps=300_000, eval_episodes=100)
    contexts = list(cmdp.space.contexts)
    policies = trainer.train_many(contexts[40:44], range(4), keep=("best",))["best"]
    seeds = range(len(contexts))
    trainer.evaluate_many(policies[:1], contexts, seeds)  # compiles
    begin = time.process_time()
    returns = trainer.evaluate_many(policies, contexts, seeds)
    ours = returns.sum() / (time.process_time() - begin)

    peer = get_cmdp("cartpole-length", engine="gymnasium").trainer_for(
        "quick", eval_episodes=5, timesteps=1
    )
    begin = time.process_time()
    theirs = peer.evaluate(policies[0], contexts, seeds)
    gymnasium = theirs.sum() / (time.process_time() - begin)
    layers = ((5, 64), (64, 64), (64, 2))
    flops = sum(2.0 * a * b for a, b in layers)
    rate = peak()
    print(f"float32 matrix product, one core: {rate / 1e9:.0f} GFLOP/s")
    print(f"mean return of these episodes: {returns.mean():.0f}")
    print("                   steps/s per core   episodes of 500 /s   of peak")
    for name, steps in (("jax", ours), ("Gymnasium, numpy", gymnasium)):
        print(f"{name:17}  {steps:16,.0f}   {steps / 500:18,.0f}   {steps * flops / rate:7.1%}")
    print(f"ratio: {ours / gymnasium:.0f}x")


if __name__ == "__main__":
    main()
