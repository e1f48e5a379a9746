"""Training and evaluation in a twin, end to end, against another checkout of this project.

Both checkouts train the same contexts with the same recipe (of the default preset), one
process after the other in turns, on one thread. The contexts are trained twice: the first time
compiles (`first_s`), the second is what counts. Steps are decisions of training episodes: those of
evaluations are part of the cost. The same seeds are used, so the scores of both must agree.

example: git worktree add ../before 60d1a26
         python benchmarks/twin_speed.py --cmdp eco-inflow --against ../before
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import measure
from measure import cost_of, digits, note

HERE = Path(__file__).resolve().parent.parent


def play(args: argparse.Namespace) -> dict[str, Any]:
    """Costs and scores of this process's own checkout."""
    from mbtl.problems import get_cmdp

    cmdp = get_cmdp(args.cmdp, engine="jax")
    trainer = cmdp.trainer_for(None, episodes=args.episodes, checkpoint_every=args.every)
    own = cmdp.space.contexts
    contexts = [own[i * len(own) // args.contexts] for i in range(args.contexts)]
    decisions = {tuple(c.items()): decisions_in(trainer, c) for c in contexts}
    policies: list[Any] = []

    def train() -> None:
        seeds = list(range(len(contexts)))
        policies[:] = trainer.train_many(contexts, seeds, keep=("final",))["final"]

    first, again = cost_of(train), cost_of(train)
    few = contexts[:: max(1, len(contexts) // 3)]
    numbers = range(len(few))
    trainer.evaluate_many(policies, few, numbers)  # compiles
    scores: list[Any] = []
    cost = cost_of(lambda: scores.append(trainer.evaluate_many(policies, few, numbers)))
    played = scores[0].size / len(few) * sum(decisions[tuple(c.items())] for c in few)
    return {
        "training": args.episodes * sum(decisions.values()) / again.cpu,
        "evaluation": played / cost.cpu,
        "first_s": first.cpu,
        "scores": [float(x) for x in scores[0].mean(axis=(1, 2))],
    }


def decisions_in(trainer: Any, context: Any) -> int:
    """Of an episode; checkouts of before had a list of parameters."""
    twin, params = trainer.problem([context])
    if isinstance(params, list):
        return int(twin.decisions(params[0]))
    from mbtl.engine.worlds.world import context_of

    return int(twin.decisions(context_of(params, 0)))


def run(checkout: Path, args: argparse.Namespace) -> dict[str, Any]:
    """`play` in a process of its own, with nothing compiled before."""
    options = [
        f"--{name}={getattr(args, name)}" for name in ("cmdp", "contexts", "episodes", "every")
    ]
    ours = {"PYTHONPATH": str(checkout / "src"), "JAX_ENABLE_COMPILATION_CACHE": "false"}
    note(f"{checkout} ...")
    done = subprocess.run(
        [sys.executable, __file__, "--alone", *options],
        env={**os.environ, **ours}, check=True, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--cmdp", default="eco-inflow")
    parser.add_argument("--against", type=Path, help="root of the other checkout")
    parser.add_argument("--contexts", type=int, default=25, help="trained together if possible")
    parser.add_argument("--episodes", type=int, default=15)
    parser.add_argument("--every", type=int, default=5, help="episodes between evaluations")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.alone:
        print(json.dumps(play(args)))
        return
    checkouts = {"here": HERE} | ({"there": args.against} if args.against else {})
    rounds = [
        {name: run(path, args) for name, path in checkouts.items()} for _ in range(args.rounds)
    ]
    lines = [f"{args.cmdp}, {args.contexts} contexts; decisions per second of processor time"]
    for what in ("training", "evaluation", "first_s"):
        lines.append(f"  {what}")
        for name in checkouts:
            each = [one[name][what] for one in rounds]
            ratio = [one[name][what] / one["here"][what] for one in rounds]
            cells = "  ".join(f"{x:10,.0f} ({r:.2f})" for x, r in zip(each, ratio, strict=True))
            lines.append(f"    {name:8}{cells}")
    apart = [
        max(abs(a - b) for a, b in zip(one["here"]["scores"], one["there"]["scores"], strict=True))
        for one in rounds
        if args.against
    ]
    lines.append(f"  mean scores differ by at most {digits(max(apart, default=0.0), 2)} m/s")
    document = {"rounds": rounds, "machine": measure.machine("jax")}
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
