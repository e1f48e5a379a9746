"""Warm starts, live: studies paid in steps that begin trainings with the weights of others.

    python evidence/warm_starts.py [--cmdp pendulum-length --cmdp cartpole-length] [--seeds 3]
    python evidence/warm_starts.py --wholes 32 --line scratch --line warm --line population

What a training becomes that begins from a policy is in no shipped curve, so these trainings are
real, by the preset `quick` (100,000 steps a whole one). Every strategy picks contexts by the
paper's MBTL, evaluates for a tenth of a training, and gets the steps of --wholes whole trainings,
all in. V is of ten fresh episodes of every policy on every context, routed by the episodes that
chose; it is read at equal steps. Rows of studies that are done are kept in --folder; the same
command goes on where it was, and prints the table. Its column *less* is V at the end less that of
the same strategy without the weights of others where there is such a line, else of whole trainings
from scratch; the interval is Student's of 95 %, paired over seeds.
"""

from __future__ import annotations

import measure

import argparse  # isort: skip
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import stats

import mbtl
from mbtl.actions import Action, FixedLength, Population, Start, StepProblem, Strategy, Trail, Warm
from mbtl.actions.evaluation import A_TENTH
from mbtl.arrays import Array
from mbtl.benchmark.steps import serving
from mbtl.cmdps import get_cmdp
from mbtl.files import whole_file
from mbtl.seeds import Purpose, evaluation_seed
from mbtl.study.steps.evaluation import evaluated
from mbtl.study.steps.state import StepState


class FromScratch:
    """The same lengths and picks from scratch: what is left is what the weights are worth."""

    def decide(self, problem: StepProblem, trail: Trail, rng: np.random.Generator) -> Action:
        """Its decision, but without a start."""
        action: Action = super().decide(problem, trail, rng)  # type: ignore[misc]
        return replace(action, start=None) if isinstance(action, Start) else action


class Cold(FromScratch, Warm):
    """Without warm starts."""


class ColdPopulation(FromScratch, Population):
    """Whose new members begin from scratch."""


READ_AT = np.array([2, 3, 4, 6, 8]) / 8
STRATEGIES: dict[str, Strategy] = {
    "scratch, whole": FixedLength("mbtl", evaluation=A_TENTH),
    "scratch, 1/4": FixedLength("mbtl", length=-3, evaluation=A_TENTH),
    "first whole, then scratch, 1/4": Cold(turns=0),
    "first whole, then warm, 1/4": Warm(turns=0),
    "first whole, then warm, whole": Warm(turns=0, length=-1),
    "warm and scratch in turns (`--strategy warm`)": Warm(),
    "population (`--strategy population`)": Population(),
    "population, new members from scratch": ColdPopulation(),
}
SCRATCH = "scratch, whole"
AGAINST = {
    "first whole, then warm, 1/4": "first whole, then scratch, 1/4",
    "population (`--strategy population`)": "population, new members from scratch",
}
"""The line that is the same without the weights of others; of those not named it is `SCRATCH`."""


def curve(
    cmdp_id: str, strategy: Strategy, seed: int, preset: str, wholes: int
) -> dict[str, object]:
    """V on fresh episodes after each evaluation, and the steps paid then; what was done."""
    cmdp = get_cmdp(cmdp_id, visibility="hidden", engine="jax")
    trainer = cmdp.trainer_for(preset)
    budget = wholes * int(trainer.whole_steps)
    study = mbtl.create_study(
        cmdp, cost="steps", budget=budget, trainer=trainer, strategy=strategy, seed=seed
    )
    study.run(progress=False, report=False)
    fresh_seed = evaluation_seed(seed, 0, Purpose.REPORT)
    every = range(study.space.n)
    fresh = {
        policy: evaluated(study, trainer, policy, every, fresh_seed)[0].mean(axis=1)
        for policy in study.state.policies
    }
    state, spent, value = StepState(), [], []
    for event in study.events():
        state.apply(event)
        if event.kind == "evaluated":
            trail = state.trail()
            route = serving(trail.filled, trail.sources, trail.steps)
            rows = study.bounds.normalise(np.array([fresh[p] for p in trail.policies]))
            spent.append(state.spent)
            value.append(float(rows[route, np.arange(len(route))].mean()))
    kinds = [t.start is not None for t in study.trail.trainings]
    own = [
        float(study.bounds.normalise(fresh[p])[study.state.trainings[p.training].source])
        for p in study.state.policies
    ]
    return {"spent": spent, "value": value, "warm": kinds, "own": own, "whole": budget / wholes}


def at(found: dict[str, object], wholes: float) -> float:
    """V after the steps of so many whole trainings; 0 before the first evaluation."""
    spent = np.asarray(found["spent"])
    known = int(np.searchsorted(spent, wholes * float(found["whole"]), side="right"))  # type: ignore[arg-type]
    return float(np.asarray(found["value"])[known - 1]) if known else 0.0


def less(ones: Array, others: Array) -> str:
    """The mean of paired differences, with its interval."""
    difference = ones - others
    error = difference.std(ddof=1) / np.sqrt(len(difference)) if len(difference) > 1 else np.nan
    half = stats.t.ppf(0.975, len(difference) - 1) * error
    return f"{difference.mean():+.3f} ± {half:.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cmdp", action="append")
    parser.add_argument("--line", action="append", help="only those whose name begins so")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--wholes", type=int, default=8, help="the budget, in whole trainings")
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--folder", type=Path, default=Path("runs/warm-starts"))
    args = parser.parse_args()
    folder = args.folder / f"{args.preset}-{args.wholes}"
    read_at = [round(share * args.wholes) for share in READ_AT]
    chosen = {name: strategy for name, strategy in STRATEGIES.items()
              if name == SCRATCH or name.startswith(tuple(args.line or [""]))}  # fmt: skip
    for cmdp_id in args.cmdp or ("pendulum-length", "cartpole-length"):
        lines: list[str] = []
        ends: dict[str, Array] = {}
        for name, strategy in chosen.items():
            runs = []
            for seed in range(args.seeds):
                file = folder / f"{cmdp_id}-{list(STRATEGIES).index(name)}-{seed}.json"
                if not file.is_file():
                    began = measure.now()
                    found = curve(cmdp_id, strategy, seed, args.preset, args.wholes)
                    folder.mkdir(parents=True, exist_ok=True)
                    with whole_file(file) as out:
                        out.write(json.dumps(found).encode())
                    seconds = (measure.now() - began).cpu
                    measure.note(f"{cmdp_id}, {name}, seed {seed}: {seconds:.0f} s of processor")
                runs.append(json.loads(file.read_text()))
            values = np.array([[at(run, wholes) for wholes in read_at] for run in runs])
            ends[name] = values[:, -1]
            count = np.mean([len(run["warm"]) for run in runs])
            warm = np.mean([sum(run["warm"]) for run in runs])
            cells = " | ".join(f"{mean:.3f}" for mean in values.mean(axis=0))
            lines.append(f"| {name} | {cells} | {count:.1f} | {warm:.1f} |")
        for i, name in enumerate(chosen):
            other = AGAINST.get(name, SCRATCH)
            other = other if other in ends else SCRATCH
            lines[i] += f" {less(ends[name], ends[other])} |" if name != other else " |"
        heads = [f"{cmdp_id}, hidden", *map(str, read_at), "trainings", "warm", "less"]
        print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
        print("\n".join(lines), flush=True)


if __name__ == "__main__":
    main()
