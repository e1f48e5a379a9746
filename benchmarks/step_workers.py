"""Several workers on one study that is paid in steps: how much sooner its budget is spent.

Trainings and evaluations sleep, so two cores are enough for eight workers. Every worker is a
process, as `mbtl worker` is. For each strategy that can decide while others are at work: the time
until the study has ended, relative to one worker in the same run; the share of the workers' time in
trainings and evaluations; what was run twice; and how far the bill went over the budget.

    python benchmarks/step_workers.py --workers 1,2,4,8 --databases sqlite,postgresql
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from many_workers import forked, said
from postgres import Server, missing

import mbtl
from mbtl.trainer import Progress, Trained

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 100})
WHOLE, UNIT, HORIZON, EPISODES = 64_000, 1_000, 500, 2


@dataclass
class Sleeps:
    """A stepping trainer whose steps take time and no processor; it counts what it really does.

    The nearer the source and the longer the training, the longer an episode lasts, as in CartPole:
    so nobody knows beforehand what an evaluation costs.

    Attributes:
        seconds: of a whole training of mean speed; evaluations take as long for each step.
    """

    seconds: float
    eval_episodes: int = EPISODES
    steps: int = 0
    evaluation: int = 0
    slept: dict[str, float] = field(default_factory=lambda: {"training": 0.0, "evaluation": 0.0})
    policy_format = "custom"
    takes, whole, counts = frozenset({"length", "state"}), WHOLE, "steps"

    def train(self, contexts, seed, *, length=1.0, state=None, on_progress=None, **asked):
        """Unit by unit; simulators differ in speed."""
        (context,), steps, done = contexts, round(length * WHOLE), 0
        if state is not None and state.exists():
            done = json.loads(state.read_text())
        slow = np.random.default_rng(seed).uniform(0.75, 1.25)
        while done < steps:
            done += UNIT
            self.steps += UNIT
            self._sleep("training", UNIT * slow)
            if on_progress is not None:
                on_progress(Progress(done, WHOLE))
        if state is not None:
            state.with_suffix(".new").write_text(json.dumps(done))
            os.replace(state.with_suffix(".new"), state)
        return Trained(np.array([context["x"], 1.0 - np.exp(-done / 8_000)]), done)

    def evaluate_steps(self, policy, contexts, seeds):
        """Returns, and as long as the policy is good."""
        x, skill = policy
        away = np.array([[abs(c["x"] - x)] * self.eval_episodes for c in contexts])
        returns = np.clip(skill - away, 0.0, 1.0)
        steps = np.round(HORIZON * (0.1 + 0.9 * returns)).astype(int)
        self.evaluation += int(steps.sum())
        self._sleep("evaluation", float(steps.sum()))
        return returns, steps

    def evaluate(self, policy, contexts, seeds):
        """Returns alone."""
        return self.evaluate_steps(policy, contexts, seeds)[0]

    def save(self, policy, folder):
        """Two numbers."""
        np.save(folder / "policy.npy", policy)
        return True

    def load(self, folder):
        """Those."""
        return np.load(folder / "policy.npy")

    def _sleep(self, what: str, steps: float) -> None:
        begun = time.perf_counter()
        time.sleep(steps * self.seconds / WHOLE)
        self.slept[what] += time.perf_counter() - begun


def worked(url: str, folder: Path, strategy: str, number: int, trainings: int, seconds: float):
    """A study from its making to its end; what became of it."""
    name = f"{strategy}-{number}"

    def make():
        mbtl.create_study(
            SPACE, cost="steps", budget=trainings * WHOLE, strategy=strategy, storage=url,
            artifacts=folder, name=name, trainer=Sleeps(seconds), horizon=HORIZON,
            episodes=EPISODES, bounds=(0.0, 1.0),
        )  # fmt: skip

    def work():
        trainer, began = Sleeps(seconds), time.perf_counter()
        study = mbtl.StepStudy.load(url, name, artifacts=folder)
        study.run(trainer=trainer, progress=False, report=False)
        whole = time.perf_counter() - began
        return {"whole": whole, "ran": trainer.steps + trainer.evaluation, **trainer.slept}

    def look():
        study = mbtl.StepStudy.load(url, name, artifacts=folder)
        state = study.state
        sources = [t.source for t in state.trainings]
        pairs = [
            (e.data["training"], e.data["length"], target)
            for e in study.events()
            if e.kind == "evaluated"
            for target in e.data["targets"]
        ]
        return {
            "spent": state.spent, "budget": study.spec.budget, "value": study.value,
            "trainings": len(sources),
            "twice": len(sources) - len(set(sources)) + len(pairs) - len(set(pairs)),
        }  # fmt: skip

    said(*forked(make))
    began = time.perf_counter()
    started = [forked(work) for _ in range(number)]
    found = [said(*each) for each in started]
    wall = time.perf_counter() - began
    facts = said(*forked(look))
    whole = sum(one["whole"] for one in found)
    shares = {what: sum(one[what] for one in found) / whole for what in ("training", "evaluation")}
    return {"wall": wall, "ran": sum(one["ran"] for one in found), **facts, **shares}


@contextlib.contextmanager
def database(kind: str, folder: Path) -> Iterator[str]:
    if kind == "sqlite":
        yield str(folder / "study.db")
        return
    with Server() as server:
        yield server.url


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", default="1,2,4,8")
    parser.add_argument("--databases", default="sqlite,postgresql")
    parser.add_argument("--strategies", default="fixed,pilot")
    parser.add_argument("--trainings", type=int, default=40, help="whole ones, as a budget")
    parser.add_argument("--seconds", type=float, default=6.0, help="of a whole training")
    arguments = parser.parse_args()
    for kind in arguments.databases.split(","):
        if kind == "postgresql" and (reason := missing()):
            print(f"{kind}: left out, {reason}")
            continue
        for strategy in arguments.strategies.split(","):
            alone = None
            for number in map(int, arguments.workers.split(",")):
                with tempfile.TemporaryDirectory() as folder, database(kind, Path(folder)) as url:
                    one = worked(
                        url, Path(folder), strategy, number, arguments.trainings, arguments.seconds
                    )
                alone = alone or one["wall"]
                over = max(one["spent"] - one["budget"], 0.0)
                print(
                    f"{kind}, {strategy}, {number} workers: {one['trainings']} trainings, "
                    f"{one['spent']:,.0f} of {one['budget']:,} steps in {one['wall']:.1f} s, "
                    f"{alone / one['wall']:.2f} x; of the workers' time {one['training']:.1%} "
                    f"training and {one['evaluation']:.1%} evaluation; begun or evaluated twice "
                    f"{one['twice']}, run and not charged {one['ran'] - one['spent']:,.0f} steps; "
                    f"over the budget {over:,.0f} steps ({over / one['budget']:.2%}); "
                    f"V = {one['value']:.3f}; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} "
                    "cores",
                    flush=True,
                )


if __name__ == "__main__":
    main()
