"""Do sources richer than a point pay? Intervals and warm starts, at equal cost of training.

    python evidence/richer_sources.py [--cmdp cartpole-length --cmdp pendulum-length] [--seeds 2]

A *generalist* is one policy trained on an interval of the axis: the episodes of its training take
turns among 20 contexts of it. A *warm start* trains on a context from the networks of a policy that
was trained on another, with a fresh optimiser. All learn by the recipe of the CMDP, and by the same
path of the engine: a point is an interval of no width.

Every kind of source is one job per seed, whose rows are kept in --folder as a small file; the same
command goes on where it was, and prints the tables of the seeds that are complete. The peer of each
figure is the policy of a point with the same number of environment steps, in the same table.

Policies are chosen by the Sequential Oracle, and the policy for each target by its return, on one
half of the episodes; reported is the other half.
Random is the exact expectation over uniformly drawn subsets.

Notation (shapes): P = 21 policies of a job, T = 50 targets, N = 20 contexts of an interval.
    sets  (P, 2)     ends of the intervals, shares of the axis in grid steps (0 first, 1 last)
    rows  (P, 2, T)  performance, mean over the episodes to choose by and over those to report
"""

from __future__ import annotations

import measure

import argparse  # isort: skip
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.files import claimed_folder, whole_file
from mbtl.objective import marginal_gain
from mbtl.problems import get_cmdp
from mbtl.seeds import MATRIX_TRIAL, Purpose, episode_seeds, evaluation_seeds, training_seed
from mbtl.zoo.benchmark.oracle import random_weights

LANES, TARGETS, CONTEXTS, EPISODES, CHECKPOINTS = 21, 50, 20, 8, 20
WIDTHS, BUDGETS, FRACTIONS = (0.05, 0.1, 0.2, 0.4), (1, 2, 3, 5), (0.1, 0.25, 0.5)
POINTS = np.repeat(np.linspace(0.0, 1.0, LANES), 2).reshape(LANES, 2)
INTERVALS = np.array(
    [(low, low + w) for w in WIDTHS for low in np.linspace(0.0, 1.0 - w, 5)] + [(0.0, 1.0)]
)
FIVE = np.array([2, 6, 10, 14, 18])  # of POINTS, in the middle of each fifth
NEAREST = FIVE[np.abs(np.arange(LANES)[:, None] - FIVE).argmin(axis=1)]
CHOOSE, REPORT = 0, 1


@dataclass(frozen=True)
class Job:
    """Policies trained together.

    Attributes:
        name: of its files.
        sets: (P, 2).
        cost: environment steps of each, as a multiple of a point source's.
        begin: "fresh", from the "best" point of the seed, or from the "near" one of five.
    """

    name: str
    sets: Array
    cost: float = 1.0
    begin: str = "fresh"


ONE, MANY = Job("points", POINTS), Job("intervals", INTERVALS)
WARM_STARTS = (
    *(Job(f"fresh-{f}", POINTS, f) for f in FRACTIONS),
    *(Job(f"best-{f}", POINTS, f, "best") for f in FRACTIONS),
    *(Job(f"near-{f}", POINTS, f, "near") for f in FRACTIONS[:2]),
)
LONGER = tuple(Job(f"whole-{k}", np.array([(0.0, 1.0)]), k) for k in BUDGETS[1:])
JOBS = (ONE, MANY, *WARM_STARTS, *LONGER)


class Laboratory:
    """Trains and remembers the jobs of one CMDP."""

    def __init__(self, name: str, steps: int, folder: Path) -> None:
        self.name, self.folder, self.steps = name, folder / name, steps
        self.cmdp = get_cmdp(name, engine="jax")
        self.trainer: Any = self.cmdp.trainer_for("full", timesteps=steps, eval_episodes=20)
        axis = next(iter(self.cmdp.nominal or {}))
        values = np.asarray(self.cmdp.space.values(axis), dtype=float)
        self._at = lambda share: {axis: float(np.interp(share * 99.0, np.arange(100), values))}
        self.targets = np.linspace(0.0, 1.0, TARGETS)
        settings = {
            "recipe": self.trainer.recipe,
            "sets": {job.name: job.sets.tolist() for job in JOBS},
            "contexts": CONTEXTS,
            "targets": TARGETS,
            "episodes": EPISODES,
            "checkpoints": CHECKPOINTS,
        }
        with claimed_folder(self.folder, settings, "rows of richer sources"):
            pass  # of these settings

    def has(self, job: Job, seed: int) -> bool:
        """Whether the job is done."""
        return self._file(job, seed).is_file()

    def rows(self, job: Job, seed: int) -> Array:
        """(P, 2, T) of a job that is done."""
        with np.load(self._file(job, seed), allow_pickle=False) as arrays:
            return np.asarray(arrays["rows"], dtype=float)

    def train(self, job: Job, seed: int) -> None:
        """Do a job, and keep its rows."""
        cost = measure.now()
        training, rows = self._train(job, seed)
        arrays = {"rows": rows.astype(np.float32)}
        if job is ONE:  # others begin from them
            arrays |= {f"leaf_{i}": x for i, x in enumerate(_leaves(training.best))}
        with whole_file(self._file(job, seed)) as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]
        seconds = (measure.now() - cost).cpu
        measure.note(f"{self.name} {job.name} seed {seed}: {seconds:.0f} s of processor time")

    def _file(self, job: Job, seed: int) -> Path:
        return self.folder / f"{job.name}-seed{seed}.npz"

    def _train(self, job: Job, seed: int) -> tuple[Any, Array]:
        import mbtl.engine.learners as engine

        # neighbours in time are not neighbours on the axis: 13/20 is near the golden ratio
        order = np.arange(CONTEXTS) * 13 % CONTEXTS / (CONTEXTS - 1)
        shares = job.sets[:, :1] + (job.sets[:, 1:] - job.sets[:, :1]) * order
        env, flat = self.trainer.problem([self._at(share) for share in shares.ravel()])
        params = type(flat)(*(x.reshape(len(shares), CONTEXTS, *x.shape[1:]) for x in flat))
        recipe = engine.MultiTaskRecipe("ppo", self.trainer.learner)
        seeds = [training_seed(seed, MATRIX_TRIAL, lane) for lane in range(len(shares))]
        steps = round(job.cost * self.steps)
        training = engine.train(
            env, recipe, seeds, params, steps,
            checkpoint_every=math.ceil(steps / CHECKPOINTS), checkpoint_episodes=CONTEXTS,
            weights=self._parents(engine.start(env, recipe, seeds, params).best, job, seed),
        )  # fmt: skip
        _, there = self.trainer.problem([self._at(share) for share in self.targets])
        n = len(there.visible)
        halves = [evaluation_seeds(seed, MATRIX_TRIAL, range(n), p) for p in _PURPOSES]
        seeds = np.concatenate([episode_seeds(half, n, EPISODES) for half in halves], axis=1)
        returns = engine.evaluate(env, engine.actor_of(training.best), there, seeds)
        assert self.cmdp.normalisation is not None
        rows = self.cmdp.normalisation.normalise(returns).reshape(*returns.shape[:2], 2, EPISODES)
        return training, rows.mean(axis=3).transpose(0, 2, 1)

    def _parents(self, like: Any, job: Job, seed: int) -> Any:
        """Networks to begin from."""
        import jax

        if job.begin == "fresh":
            return None
        parents = NEAREST if job.begin == "near" else np.full(LANES, best_point(self, seed))
        with np.load(self._file(ONE, seed), allow_pickle=False) as arrays:
            leaves = [arrays[f"leaf_{i}"][parents] for i in range(len(_leaves(like)))]
        return jax.tree.unflatten(jax.tree.structure(like), leaves)


_PURPOSES = (Purpose.EVALUATION, Purpose.REPORT)


def _leaves(tree: Any) -> list[Array]:
    import jax

    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]


def best_point(lab: Laboratory, seed: int) -> int:
    """The Sequential Oracle's first pick among the points."""
    return int(lab.rows(ONE, seed)[:, CHOOSE].mean(axis=1).argmax())


# ---- what sets of policies are worth -------------------------------------------------------------


def oracle(rows: Array, count: int, base: Array | None = None) -> float:
    """V of the `count` policies that the Sequential Oracle adds to `base`, (2, T)."""
    best = np.full(rows.shape[1:], -np.inf) if base is None else base
    for _ in range(min(count, len(rows))):
        if np.isfinite(best).all():
            gain = marginal_gain(rows[:, CHOOSE], best[CHOOSE])
        else:
            gain = rows[:, CHOOSE].mean(axis=1)
        one = rows[int(gain.argmax())]
        best = np.where(one[CHOOSE] > best[CHOOSE], one, best)
    return float(best[REPORT].mean())


def random(rows: Array, count: int, base: Array | None = None) -> float:
    """Expected V of `count` different policies drawn uniformly, beside `base`."""
    some = rows if base is None else np.where(rows[:, [CHOOSE]] > base[CHOOSE], rows, base)
    order = np.argsort(-some[:, CHOOSE], axis=0, kind="stable")
    reported = np.take_along_axis(some[:, REPORT], order, axis=0)
    count = min(count, len(rows))
    return float((random_weights(len(rows), count)[-1] @ reported).mean())


def own(rows: Array, sets: Array, targets: Array) -> Array:
    """(P,) performance on the targets inside the interval; on the nearest one if there is none."""
    middle, half = sets.mean(axis=1)[:, None], np.ptp(sets, axis=1)[:, None] / 2
    away = np.abs(targets - middle)
    inside = away <= np.maximum(half, away.min(axis=1, keepdims=True)) + 1e-9
    return (rows[:, REPORT] * inside).sum(axis=1) / inside.sum(axis=1)


# ---- tables --------------------------------------------------------------------------------------


def table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Markdown."""
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, ["---"] * len(head), *lines))


def over_seeds(values: Sequence[float]) -> str:
    """Mean and, where there are several, standard deviation."""
    if len(values) < 2:
        return f"{values[0]:.3f}" if values else ""
    return f"{np.mean(values):.3f} ± {np.std(values, ddof=1):.3f}"


Rows = Mapping[str, Sequence[Array]]
"""Job name -> rows of each seed."""


def widths(lab: Laboratory, rows: Rows) -> str:
    """One policy: what it does at home and everywhere."""
    lines = []
    for width in (0.0, *WIDTHS, 1.0):
        job = MANY if width else ONE
        some = np.isclose(np.ptp(job.sets, axis=1), width)
        found = [r[some] for r in rows[job.name]]
        lines.append(
            [
                f"{100 * width:.0f} %",
                str(some.sum()),
                over_seeds([own(r, job.sets[some], lab.targets).mean() for r in found]),
                over_seeds([r[:, REPORT].mean() for r in found]),
                over_seeds([oracle(r, 1) for r in found]),
            ]
        )
    head = (
        "width",
        "policies per seed",
        "own interval",
        "all targets",
        "the best one, all targets",
    )
    return table(head, lines)


def portfolios(lab: Laboratory, rows: Rows) -> str:
    """V of K policies that cost as much as K points."""
    n_seeds = min(len(rows["points"]), len(rows["intervals"]))
    points, intervals = rows["points"][:n_seeds], rows["intervals"][:n_seeds]
    twice = [np.concatenate([a, b]) for a, b in zip(points, [*points[1:], points[0]], strict=True)]
    both = [np.concatenate(pair) for pair in zip(points, intervals, strict=True)]
    sets = {
        "21 points, random": (points, random),
        "21 intervals, random": (intervals, random),
        "21 points, oracle": (points, oracle),
        "21 intervals, oracle": (intervals, oracle),
        "points and intervals, oracle": (both, oracle),
        "... as many points: two trainings of each, oracle": (twice, oracle),
    }
    lines = [
        [name, *(over_seeds([value(r, k) for r in found]) for k in BUDGETS)]
        for name, (found, value) in sets.items()
        if len(points) > 1 or found is not twice
    ]
    whole = [[r[-1:] for r in intervals], *(rows.get(job.name, []) for job in LONGER)]
    values = [over_seeds([r[0, REPORT].mean() for r in found]) for found in whole]
    lines.append(["one policy on the whole axis, K x the steps", *values])
    every = np.ptp(np.concatenate([POINTS, INTERVALS]), axis=1)
    picks = [f"{100 * every[r[:, CHOOSE].mean(axis=1).argmax()]:.0f} %" for r in both]
    note = f"Width of the first pick from points and intervals, by seed: {', '.join(picks)}."
    return table(("", *(f"K = {k}" for k in BUDGETS)), lines) + "\n\n" + note


def warm(lab: Laboratory, rows: Rows) -> str:
    """One more training at a part of the cost: fresh, or from a policy that is there."""
    n_seeds = len(rows["points"])
    best = [best_point(lab, seed) for seed in range(n_seeds)]
    first = [rows["points"][s][best[s]] for s in range(n_seeds)]
    untrained = {
        "best": [np.repeat(f[None], LANES, axis=0) for f in first],
        "near": [r[NEAREST] for r in rows["points"]],
    }
    lines = []
    for cost in (0.0, *FRACTIONS, 1.0):
        for begin in ("fresh", "best", "near"):
            name = "points" if (cost, begin) == (1.0, "fresh") else f"{begin}-{cost}"
            found = rows.get(name) or (untrained.get(begin) if not cost else None)
            if not found:
                continue
            pairs = list(zip(found, first, strict=True))
            gains = [random(r, 1, f) - f[REPORT].mean() for r, f in pairs]
            tops = [oracle(r, 1, f) - f[REPORT].mean() for r, f in pairs]
            lines.append(
                [
                    f"{100 * cost:.0f} %",
                    {"fresh": "fresh", "best": "the best point", "near": "nearest of five"}[begin],
                    over_seeds([own(r, POINTS, lab.targets).mean() for r in found]),
                    over_seeds([r[:, REPORT].mean() for r in found]),
                    over_seeds(gains),
                    over_seeds(tops),
                ]
            )
    head = ("steps", "begins from", "own context", "all targets", "gain beside the best point",
            "the largest gain")  # fmt: skip
    return table(head, lines)


def equal_cost(lab: Laboratory, rows: Rows) -> str:
    """V of the best point and as many more policies as the rest of the budget pays."""
    n_seeds = len(rows["points"])
    first = [rows["points"][s][best_point(lab, s)] for s in range(n_seeds)]
    lines = []
    for budget in BUDGETS[1:]:
        for cost in (1.0, *FRACTIONS[::-1]):
            count = round((budget - 1) / cost)
            if count > LANES:
                continue
            cells = []
            for begin in ("fresh", "best"):
                found = rows.get("points" if cost == 1.0 else f"{begin}-{cost}", [])
                for value in (random, oracle):
                    if (cost, begin) == (1.0, "best"):
                        cells.append("")
                        continue
                    worth = [value(r, count, f) for r, f in zip(found, first, strict=bool(found))]
                    cells.append(over_seeds(worth))
            if any(cells):
                lines.append([str(budget), f"1 + {count} at {100 * cost:.0f} %", *cells])
    head = ("cost", "policies", "fresh, random", "fresh, oracle", "warm, random", "warm, oracle")
    return table(head, lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cmdp", action="append", help="one axis of 100; may be repeated")
    parser.add_argument("--steps", type=int, default=300_000, help="of a point source")
    parser.add_argument("--seeds", type=int, default=2, help="of points and intervals")
    parser.add_argument("--more-seeds", type=int, default=1, help="of all the rest")
    parser.add_argument("--folder", type=Path, default=Path("runs/richer-sources"))
    parser.add_argument("--tables", action="store_true", help="of what is there; train nothing")
    args = parser.parse_args()
    names = args.cmdp or ["cartpole-length", "pendulum-length"]
    labs = [Laboratory(name, args.steps, args.folder) for name in names]
    plan = [(job, seed) for seed in range(args.seeds) for job in (ONE, MANY)]
    plan += [(job, seed) for seed in range(args.more_seeds) for job in (*WARM_STARTS, *LONGER)]
    for job, seed in plan:
        for lab in labs:
            if not (args.tables or lab.has(job, seed)):
                lab.train(job, seed)
    for lab in labs:
        rows: dict[str, list[Array]] = {}
        for job, seed in plan:
            if lab.has(job, seed):
                rows.setdefault(job.name, []).append(lab.rows(job, seed))
        print(f"\n## {lab.name}, {args.steps:,} steps per point")
        # what is compared in one table is of the same seeds
        few = {n: r[: args.more_seeds] for n, r in rows.items() if len(r) >= args.more_seeds}
        for make, some in ((widths, rows), (portfolios, rows), (warm, few), (equal_cost, few)):
            print("", make(lab, some), sep="\n")


if __name__ == "__main__":
    main()
