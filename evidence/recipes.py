"""Why our recipes are what they are: the same trainings with one choice changed.

    python evidence/recipes.py ring-acc                      # ten minutes of a core
    python evidence/recipes.py ramp-acc --engine sumo

CartPole and Pendulum: the recipe of mbtl beside Stable-Baselines3's (`sb3`; `jax_parity.py` shows
that it is), 1 M steps on ten contexts; returns of the best checkpoint on fresh episodes of the own
context. The ring: whether TRPO learns from applied actions or from samples beyond their bounds, and
whether it standardises advantages. The signal's twin: PPO, A2C and DQN. In SUMO, the ramp: whose
rewards an action is credited with, and how far it looks; signals: the paper's network with a
quarter of its gradient steps, the small one of `standard`, and that with observations turned.
Printed are the score on the context trained on, in brackets the mean over the contexts of the
others, those of each training, processor seconds of one, and of CartPole and Pendulum how far a way
is from the first, with a 90 % interval, as a share of the bounds.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import stats

from mbtl.problems import CMDP, get_cmdp
from mbtl.seeds import evaluation_seeds, training_seed

CONTROL = ("cartpole-length", "pendulum-length")
SOURCES = (0, 4, 9, 19, 29, 39, 49, 64, 79, 99)
"""Contexts of CartPole and Pendulum, by index."""
STEPS = 1_000_000
CONTEXTS = {
    "ring-acc": (2.0, 10.0, 20.0, 30.0, 40.0),
    "ramp-acc": (2.0, 10.0, 25.0),
    "ramp-vel": (2.0, 10.0, 25.0),
    "signal-inflow": (1000.0, 2000.0),
}
IN_SUMO = {"signal-inflow": (1000.0, 2000.0, 2450.0)}
EPISODES = {"signal-inflow": 30, "ramp-acc": 60, "ramp-vel": 60}
"""Of a training in SUMO."""
PAPER_STEPS = 200
"""Gradient steps per episode of the paper's network in SUMO; the paper's own are 800."""


def in_twin(cmdp: CMDP) -> dict[str, Any]:
    """Trainers by name."""
    trainer: Any = replace(cmdp.trainer_for(), eval_episodes=8)
    if cmdp.id == "ring-acc":
        flags = [("clip_actions", False), ("normalize_advantage", True)]
        ways = {"as it is": [], "samples": flags[:1], "standardised": flags[1:], "both": flags}
        own = trainer.hyperparameters
        return {n: replace(trainer, hyperparameters=own | dict(w)) for n, w in ways.items()}
    ours = {"PPO": trainer}
    for name in ("A2C", "DQN"):
        other = {"algorithm": name, "recipe_name": "fast", "hyperparameters": {}}
        ours[name] = replace(trainer, **other)
    return ours


def in_control(cmdp: CMDP) -> dict[str, Any]:
    """Trainers by name; nothing of our own is on top of `sb3`."""
    ours = cmdp.trainer_for("full", algorithm="PPO", timesteps=STEPS)
    plain = type(ours)(ours.problem, timesteps=STEPS, recipe_name="sb3", algorithm="PPO")
    return {"sb3": plain, "ours": ours}


def in_sumo(cmdp: CMDP) -> dict[str, Any]:
    """Trainers by name."""
    alike = {"checkpoint": "final", "episodes": EPISODES[cmdp.id], "eval_episodes": 4}
    standard, paper = (replace(cmdp.trainer_for(name), **alike) for name in ("standard", "paper"))
    if cmdp.family != "signal":
        ways = {f"credit {whose}": replace(paper, credit=whose) for whose in ("own", "team")}
        return ways | {"team, near-sighted": standard}
    small = standard.hyperparameters
    kinds = {
        "the paper's network": {**paper.hyperparameters, "gradient_steps": PAPER_STEPS},
        "a small one": {k: v for k, v in small.items() if k != "replay_buffer_class"},
        "that, turned": small,
    }
    return {name: replace(standard, hyperparameters=kind) for name, kind in kinds.items()}


def own_returns(trainer: Any, cmdp: CMDP, seeds: int) -> tuple[list[float], list[float]]:
    """Of CartPole and Pendulum: all trainings in one program."""
    each = [(source, seed) for source in SOURCES for seed in range(seeds)]
    contexts = [cmdp.space.contexts[source] for source, _ in each]
    policies = trainer.train_many(contexts, [training_seed(seed, 0, s) for s, seed in each])["best"]
    fresh = evaluation_seeds(0, 0, [0])
    pairs = zip(policies, contexts, strict=True)
    return [float(trainer.evaluate(p, [c], fresh).mean()) for p, c in pairs], []


def scores(trainer: Any, contexts: list[Any], seeds: int) -> tuple[list[float], list[float]]:
    """On the context trained on and the mean of the others, one training after another."""
    own, others = [], []
    for k, context in enumerate(contexts):
        for seed in range(seeds):
            print(f"{context}, seed {seed} ...", file=sys.stderr)
            policy = trainer.train([context], seed).policy
            found = trainer.evaluate(policy, contexts, range(len(contexts))).mean(axis=1)
            own.append(float(found[k]))
            others.append(float((found.sum() - found[k]) / (len(found) - 1)))
    return own, others


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cmdp", choices=(*CONTROL, *CONTEXTS))
    parser.add_argument("--engine", choices=("jax", "sumo"), default="jax")
    parser.add_argument("--seeds", type=int, help="trainings per way and context")
    args = parser.parse_args()
    control, sumo = args.cmdp in CONTROL, args.engine == "sumo"
    score = "paper" if args.cmdp.startswith("signal") else None
    cmdp = get_cmdp(args.cmdp, engine=args.engine, score=score)
    seeds = args.seeds or (3 if control else 2)
    first: np.ndarray | None = None
    for name, trainer in (in_control if control else in_sumo if sumo else in_twin)(cmdp).items():
        begin = time.process_time()
        if control:
            own, others = own_returns(trainer, cmdp, seeds)
        else:
            (axis,) = (axis.name for axis in cmdp.space.axes)
            values = (IN_SUMO if sumo else {}).get(args.cmdp, CONTEXTS[args.cmdp])
            own, others = scores(trainer, [{axis: value} for value in values], seeds)
        seconds = (time.process_time() - begin) / len(own)
        elsewhere = f" ({np.mean(others):.2f})" if others else ""
        rows = " ".join(f"{x:.2f}" for x in own)
        print(
            f"{name:22}{np.mean(own):8.2f}{elsewhere}   {rows}   {seconds:.3g} s each", flush=True
        )
        if control and first is not None:
            low, high = cmdp.bounds
            gap = 100.0 * (np.array(own) - first) / (high - low)
            half = stats.t.ppf(0.95, len(gap) - 1) * gap.std(ddof=1) / np.sqrt(len(gap))
            print(f"  less the first: {gap.mean():+.1f} % +- {half:.1f} % of the bounds")
        first = np.array(own) if first is None else first


if __name__ == "__main__":
    main()
