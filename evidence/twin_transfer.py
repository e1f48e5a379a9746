"""Do policies of a twin transfer in its simulator as they do in the twin? One sub-matrix in both.

    .venv/bin/python evidence/twin_transfer.py [--cmdp ring-acc] [--sources 6] [--targets 8]
        [--episodes 5] [--train 300] [--train-in jax|sumo] [--policies FOLDER]

The simulator is SUMO or, of walkers, Box2D. Trains each source in the twin, or in SUMO (preset
`quick`, with as many training episodes as `--train`), or takes the policies that the build of a
matrix kept (`--policies runs/matrix-.../policies/best`: the sources nearest to evenly spread ones;
walkers are not trained here). Then evaluates every policy on every target in the twin, and twice in
the simulator with other seeds. Printed: the mean score of each source, the correlation of all
entries, and Spearman's rank correlation of the source means, of the twin against the simulator and
of that against itself; scores below the CMDP's floor count as the floor.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy import stats

from mbtl.problems import get_cmdp
from mbtl.seeds import Purpose, evaluation_seeds, training_seed
from mbtl.trainers import export_mlp


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cmdp", default="ring-acc")
    parser.add_argument("--sources", type=int, default=6)
    parser.add_argument("--targets", type=int, default=8)
    parser.add_argument("--episodes", type=int, default=5)
    parser.add_argument("--train", type=int, default=300)
    parser.add_argument("--train-in", choices=["jax", "sumo"], default="jax")
    parser.add_argument("--policies", type=Path)
    args = parser.parse_args()
    walks = args.cmdp.startswith("walker")
    if walks and not args.policies:
        parser.error("walkers need --policies, those that the build of a matrix kept")
    name, engine = ("Box2D", "gymnasium") if walks else ("SUMO", "sumo")
    score = "paper" if args.cmdp.startswith(("eco", "signal")) else None
    twin, native = (get_cmdp(args.cmdp, engine=one, score=score) for one in ("jax", engine))
    n = twin.space.n
    sources, targets = (
        np.unique(np.linspace(0, n - 1, count).round().astype(int))
        for count in (args.sources, args.targets)
    )
    if args.policies:
        kept = np.array(sorted(int(one.name.split("-")[1]) for one in args.policies.iterdir()))
        sources = np.unique([kept[np.abs(kept - source).argmin()] for source in sources])
    there = [twin.space.contexts[i] for i in targets]
    length = {} if args.policies else {"episodes": args.train}
    trainer = twin.trainer_for("quick", **length, eval_episodes=10 * args.episodes)
    seeds = [training_seed(0, 0, int(i)) for i in sources]
    lessons = [twin.space.contexts[i] for i in sources]
    if args.policies:
        policies = [trainer.load(args.policies / f"source-{i:05d}") for i in sources]
    elif args.train_in == "jax":
        kept = trainer.checkpoint
        policies = trainer.train_many(lessons, seeds, keep=(kept,))[kept]
    else:
        school = native.trainer_for("quick", **length)
        policies = [
            school.train([one], seed).policy for one, seed in zip(lessons, seeds, strict=True)
        ]
    if args.train_in == "sumo":
        policies = [export_mlp(policy) for policy in policies]
    acting = {} if walks else {"acting": trainer.acting}
    judge = native.trainer_for(
        "standard" if walks else "quick", eval_episodes=args.episodes, **acting
    )
    purposes = Purpose.EVALUATION, Purpose.REPORT
    seeds = {p: evaluation_seeds(0, 0, range(len(there)), p) for p in purposes}
    found = {"twin": _means(trainer, policies, there, seeds[Purpose.EVALUATION])}
    again = f"{name} again"
    for one, purpose in zip((name, again), purposes, strict=True):
        found[one] = _means(judge, policies, there, seeds[purpose])
    floor = twin.floor  # none is worse, as in a matrix
    found = {
        key: matrix if floor is None else np.maximum(matrix, floor) for key, matrix in found.items()
    }
    axis = next(iter(twin.nominal or {}))
    print(f"\n{args.cmdp}, mean score over {len(targets)} targets by source ({axis})")
    print("source       " + " ".join(f"{twin.space.contexts[i][axis]:8g}" for i in sources))
    for engine, matrix in found.items():
        print(f"{engine:12} " + " ".join(f"{mean:8.3f}" for mean in matrix.mean(axis=1)))
    for one, other in (("twin", name), ("twin", again), (name, again)):
        a, b = found[one], found[other]
        ranks = stats.spearmanr(a.mean(axis=1), b.mean(axis=1)).statistic
        entries = np.corrcoef(a.ravel(), b.ravel())[0, 1]
        print(
            f"{one} against {other}: Spearman of source means {ranks:.2f}, correlation of entries "
            f"{entries:.3f}, mean difference {np.mean(a - b):+.3f}"
        )


def _means(trainer, policies, contexts, seeds):  # type: ignore[no-untyped-def]
    """(sources, targets) mean scores."""
    return np.array([trainer.evaluate(p, contexts, seeds).mean(axis=1) for p in policies])


if __name__ == "__main__":
    main()
