"""A real problem with a quick trainer: a point mass on a line, policies found by random search."""

import numpy as np

import mbtl
from mbtl.trainers import FunctionTrainer

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("mass", 0.2, 4.0, unit="kg"): 15})
STEPS = 20


def rollout(gains, mass, starts):
    """Return of pushing a mass to the origin with force -k x - c v; (episodes,)."""
    x, v = starts[:, 0].copy(), starts[:, 1].copy()
    total = np.zeros(len(starts))
    for _ in range(STEPS):
        force = np.clip(-gains[0] * x - gains[1] * v, -1.0, 1.0)
        v += 0.1 * force / mass
        x += 0.1 * v
        total -= x**2
    return total


def train(context, seed):
    rng = np.random.default_rng(seed)
    starts = rng.uniform(-1, 1, (8, 2))
    candidates = rng.uniform(0, 4, (60, 2))
    scores = [rollout(gains, context["mass"], starts).mean() for gains in candidates]
    return candidates[int(np.argmax(scores))]


def train_any(contexts, seed, *, start=None, length=None):
    """On several contexts as on their mean; from a policy near it, as much longer as is said."""
    rng = np.random.default_rng(seed)
    starts = rng.uniform(-1, 1, (8, 2))
    count = round(60 * (1.0 if length is None else length))
    candidates = rng.uniform(0, 4, (count, 2))
    if start is not None:
        candidates = np.vstack([start, start + rng.normal(0.0, 0.3, (count, 2))])
    scores = [
        np.mean([rollout(gains, context["mass"], starts).mean() for context in contexts])
        for gains in candidates
    ]
    return candidates[int(np.argmax(scores))]


def evaluate(policy, contexts, seeds):
    starts = [np.random.default_rng(seed).uniform(-1, 1, (5, 2)) for seed in seeds]
    pairs = zip(contexts, starts, strict=True)
    return np.array([rollout(policy, context["mass"], own) for context, own in pairs])


def save(policy, folder):
    np.save(folder / "gains.npy", policy, allow_pickle=False)


def load(folder):
    return np.load(folder / "gains.npy", allow_pickle=False)


TRAINER = FunctionTrainer(train, evaluate, save, load)
ANY_TRAINER = FunctionTrainer(train_any, evaluate, save, load)
