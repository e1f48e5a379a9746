"""Your own simulator without any RL library: a cart on a track, policies by random search.

    python examples/own_simulator.py
    mbtl run examples/own_simulator.py:problem --budget 4 --parallel 2

Two functions are all that mbtl needs; save and load let a study keep its policies. They are named
functions rather than lambdas, so that they can be sent to other processes.
"""

import numpy as np

import mbtl


def simulate(gains, mass, starts):
    """Return of pulling a cart of `mass` kg to the origin within 4 s; one per start."""
    x, v = starts.T.copy()
    cost = np.zeros(len(starts))
    for _ in range(40):
        v += 0.1 * np.clip(-gains[0] * x - gains[1] * v, -1.0, 1.0) / mass
        x += 0.1 * v
        cost += 0.1 * x**2
    return -cost


def train(context, seed):
    rng = np.random.default_rng(seed)
    starts, candidates = rng.uniform(-1, 1, (8, 2)), rng.uniform(0, 4, (100, 2))
    return max(candidates, key=lambda gains: simulate(gains, context["mass"], starts).mean())


def evaluate(policy, contexts, seeds):
    returns = []
    for context, seed in zip(contexts, seeds, strict=True):  # starts of its own for each context
        starts = np.random.default_rng(seed).uniform(-1, 1, (20, 2))
        returns.append(simulate(policy, context["mass"], starts))
    return returns


def save(policy, folder):
    np.save(folder / "gains.npy", policy)


def load(folder):
    return np.load(folder / "gains.npy")


problem = mbtl.CMDP.from_functions(
    "cart",
    mbtl.ContextSpace.grid({mbtl.Log("mass", 0.1, 10.0, unit="kg"): 30}),
    train=train,
    evaluate=evaluate,
    save=save,
    load=load,
    bounds=(-4.0, 0.0),
    budget=5,
)

if __name__ == "__main__":
    portfolio = problem.study().run().portfolio()
    masses = [problem.space.context(source)["mass"] for source in portfolio.sources]
    print("trained on masses", np.round(masses, 2))
    print(portfolio.explain({"mass": 1.7}).explanation)
