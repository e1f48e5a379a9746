"""A problem whose trainings take steps: the nearer the source and the longer, the better.

Run as a program it does what `mbtl run --steps` does: it opens the study or goes on with it, and
says at the end all that must not depend on interruptions; it kills itself after so much work.
"""

import json
import os
import signal
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from warm_strategy import NAMED

import mbtl
from mbtl.trainer import Progress, Trained

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 11})
WHOLE, HORIZON, UNIT = 64_000, 20, 1_000


class OfNumbers:
    """What trainers share whose policies are a few numbers."""

    def evaluate(self, policy, contexts, seeds):
        return self.evaluate_steps(policy, contexts, seeds)[0]

    def save(self, policy, folder):
        np.save(folder / "policy.npy", policy)
        return True

    def load(self, folder):
        return np.load(folder / "policy.npy")


@dataclass
class Slow(OfNumbers):
    """A trainer that can do everything, and counts all it really does, unit by unit."""

    eval_episodes: int = 2
    dies_after: int | None = None
    fails_at: float | None = None
    level: float = 0.98
    ran: dict = field(default_factory=lambda: {"steps": 0, "checks": 0, "evaluation": 0})
    policy_format = "custom"
    takes = frozenset({"sets", "start", "length", "state"})
    whole, counts = WHOLE, "steps"

    def train(self, contexts, seed, *, length=1.0, done=0.0, marks=(), **given):
        assert done == 0.0  # its state is kept
        steps = round(length * self.whole)
        if len(contexts) == 1:
            return self.on_one(contexts[0], seed, steps, **given)
        marks = [round(mark * self.whole) for mark in marks]
        return self.on_several(contexts, seed, steps, marks, **given)

    def on_one(self, context, seed, steps, *, start=None, state=None, on_progress=None):
        done, checks, skill = 0, 0, 0.0
        if start is not None:  # what its weights are worth here
            skill = max(float(start[1]) - abs(context["x"] - float(start[0])), 0.0)
        if state is not None and state.exists():
            done, checks, skill = json.loads(state.read_text())
        rng = np.random.default_rng(seed)
        speed = rng.uniform(0.5, 1.0)
        while done < steps and skill < 0.99:
            done += UNIT
            skill = 1 - (1 - skill) * np.exp(-speed * UNIT / 8_000)
            checks += 7
            self.ran["steps"] += UNIT
            self.ran["checks"] += 7
            self.work()
            if context["x"] == self.fails_at and done >= 5_000:
                raise RuntimeError("the simulator fell over")
            if on_progress is not None:
                on_progress(Progress(done, WHOLE))
        if state is not None:
            state.with_suffix(".new").write_text(json.dumps([done, checks, skill]))
            os.replace(state.with_suffix(".new"), state)
        return Trained(np.array([context["x"], skill]), done, checks, ended=bool(skill >= 0.99))

    def on_several(self, contexts, seed, steps, marks, *, start=None, state=None, on_progress=None):
        """Worth `level` everywhere after 8,000 steps; 0.0 before."""
        done = json.loads(state.read_text()) if state is not None and state.exists() else 0
        while done < steps:
            done += UNIT
            self.ran["steps"] += UNIT
            self.work()
        if state is not None:
            state.with_suffix(".new").write_text(json.dumps(done))
            os.replace(state.with_suffix(".new"), state)
        return Trained(np.array([np.nan, self.level if done >= 8_000 else 0.0]), done)

    def work(self):
        if self.dies_after is not None:
            self.dies_after -= 1
            if self.dies_after < 0:
                os.kill(os.getpid(), signal.SIGKILL)

    def evaluate_steps(self, policy, contexts, seeds):
        self.work()
        x, skill = policy
        away = [0.0 if np.isnan(x) else abs(c["x"] - x) for c in contexts]
        returns = np.array([[skill - gap] * self.eval_episodes for gap in away])
        luck = [np.random.default_rng(s).standard_normal(self.eval_episodes) for s in seeds]
        returns = returns + 0.01 * np.array(luck)
        steps = np.full(returns.shape, 10 + round(5 * skill))
        self.ran["evaluation"] += int(steps.sum())
        return returns, steps


def opened(trainer, folder=None, budget=150_000, **settings):
    given = {"horizon": HORIZON, "bounds": (0.0, 1.0), "episodes": 2, "seed": 3, **settings}
    storage = None if folder is None else Path(folder) / "study.db"
    return mbtl.create_study(
        SPACE, cost="steps", budget=budget, trainer=trainer, storage=storage,
        load_if_exists=True, **given,
    )  # fmt: skip


def outcome(study):
    """Everything that must not depend on interruptions."""
    state = study.state
    return {
        "trainings": [[t.source, t.steps, t.checks, t.ended, len(t.on)] for t in state.trainings],
        "policies": [[p.training, p.length] for p in state.policies],
        "returns": np.nan_to_num(np.array(state.returns), nan=-9.0).tolist(),
        "spent": state.spent,
        "fresh": state.fresh.returns.tolist(),
        "stopped": state.stopped,
    }


if __name__ == "__main__":
    name = sys.argv[3] if len(sys.argv) > 3 else "pilot"
    strategy = NAMED.get(name, name)
    study = opened(Slow(dies_after=int(sys.argv[2])), sys.argv[1], strategy=strategy)
    study.run(progress=False)
    print(json.dumps(outcome(study)))
