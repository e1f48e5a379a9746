"""Does training hang? Twenty guarded runs with 100 policies on two threads.

    .venv/bin/python evidence/jax_hang.py [--runs 20] [--threads 2] [--unsafe]

jax 0.10's concurrency-optimised scheduler can wait for ever in programs of many small operations on
few cores; `mbtl.engine.worlds` switches it off and asks for one thread. Here every run is a process
of its own with `--threads` threads and a time limit; `--unsafe` leaves the scheduler on: the peer.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time

PROGRAM = """
import mbtl.engine.learners as engine
from mbtl.problems import get_cmdp
cmdp = get_cmdp("cartpole-length", engine="jax")
env, params = cmdp.trainer.problem(cmdp.space.contexts)
recipe = engine.PPORecipe(n_envs=8, n_steps=128, batch_size=256, n_epochs=4)
engine.train(env, recipe, range(100), params, 8 * 1024, checkpoint_every=2 * 1024)
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--limit", type=float, default=180.0, help="seconds per run")
    parser.add_argument("--unsafe", action="store_true")
    args = parser.parse_args()
    environ = {**os.environ, "NPROC": str(args.threads)}
    if args.unsafe:
        environ["XLA_FLAGS"] = "--xla_cpu_enable_concurrency_optimized_scheduler=true"
    ended = 0
    for run in range(args.runs):
        begin = time.perf_counter()
        try:
            subprocess.run(
                [sys.executable, "-c", PROGRAM], env=environ, timeout=args.limit, check=True
            )
            ended += 1
            result = "ended"
        except subprocess.TimeoutExpired:
            result = "HUNG (stopped at the limit)"
        print(f"run {run + 1}: {result}, {time.perf_counter() - begin:.0f} s", flush=True)
    print(f"{ended} of {args.runs} ended ({args.threads} threads)")


if __name__ == "__main__":
    main()
