"""A real problem in one line: a policy is a point, and worth less the farther from it it acts."""

import numpy as np

import mbtl
from mbtl.trainers import FunctionTrainer

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 7})


def train(context, seed):
    return np.array([context["x"]])


def evaluate(policy, contexts, seeds):
    return [1 - abs(c["x"] - policy[0]) for c in contexts]


def save(policy, folder):
    np.save(folder / "x.npy", policy)


def load(folder):
    return np.load(folder / "x.npy")


TRAINER = FunctionTrainer(train, evaluate, save, load)
