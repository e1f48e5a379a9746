"""A real problem in one line: a policy is a point, and worth less the farther from it it acts."""

import mbtl
from mbtl.trainers import FunctionTrainer


def line(n):
    return mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): n})


def train(context, seed):
    return context["x"]


def evaluate(policy, contexts, seeds):
    return [1 - abs(c["x"] - policy) for c in contexts]


def save(policy, folder):
    (folder / "x.txt").write_text(repr(policy))


def load(folder):
    return float((folder / "x.txt").read_text())


SPACE = line(7)
TRAINER = FunctionTrainer(train, evaluate, save, load)
