"""What a ramp's shared policy learns in few episodes: whose rewards count, and how far it looks.

The same training on the same seeds in three ways: with the paper's values, each action credited
with what its own car is given until it leaves, or with what the team earns until the end, as in the
paper; and as the preset `standard` does, credited with the team's and near-sighted. Scores are mean
speeds of three fresh episodes on the hold trained on; `step({})`, nobody advised, is the peer.

example: python benchmarks/ramp_learning.py --cmdp ramp-acc     # ten minutes of a core
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import measure
from measure import digits, note

HOLDS = (2.0, 10.0, 25.0)
EVALUATION = 1
"""Seed of all evaluations."""


def ways(cmdp: Any, episodes: int) -> dict[str, Any]:
    """Trainers by name."""
    paper, standard = cmdp.trainer_for("paper"), cmdp.trainer_for("standard")
    alike = {"episodes": episodes, "eval_episodes": 3, "checkpoint": standard.checkpoint}
    return {
        "own rewards": replace(paper, credit="own", **alike),
        "the team's": replace(paper, credit="team", **alike),
        "the team's, near-sighted": replace(standard, **alike),
    }


def unguided(trainer: Any) -> float:
    """Mean speed without advice, whatever the hold [m/s]."""
    scores = []
    env = trainer.make_env({"hold": HOLDS[-1]})
    for seed in range(trainer.eval_episodes):
        env.reset(seed=seed)
        while env.agents:
            env.step({})
        scores.append(env.score)
    env.close()
    return digits(sum(scores) / len(scores), 3)


def main() -> None:
    """Train, evaluate and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--cmdp", choices=("ramp-acc", "ramp-vel"), default="ramp-acc")
    parser.add_argument("--episodes", type=int, default=60, help="per training")
    parser.add_argument("--seeds", type=int, default=2, help="trainings per way and hold")
    args = parser.parse_args()
    from mbtl.cmdps import get_cmdp

    trainers = ways(get_cmdp(args.cmdp), args.episodes)
    scores: dict[str, dict[float, list[float]]] = {name: {} for name in trainers}
    for hold in HOLDS:
        context = {"hold": hold}
        for name, trainer in trainers.items():
            note(f"hold {hold:g} s, {name} ...")
            policies = [trainer.train(context, seed) for seed in range(args.seeds)]
            found = [trainer.evaluate(p, [context], EVALUATION).mean() for p in policies]
            scores[name][hold] = [digits(float(score), 3) for score in found]
    alone = unguided(trainers["own rewards"])
    document = {
        "cmdp": args.cmdp,
        "episodes": args.episodes,
        "scores": scores,
        "unguided": alone,
        "machine": measure.machine("libsumo", "sb3_contrib"),
    }
    lines = [f"{args.cmdp}, {args.episodes} episodes: m/s on the own hold, by seed"]
    lines.append(" " * 26 + "".join(f"{f'{hold:g} s':>18}" for hold in HOLDS) + "      mean")
    for name, by_hold in scores.items():
        rows = "".join(f"{' '.join(f'{x:.2f}' for x in by_hold[h]):>18}" for h in HOLDS)
        every = [x for found in by_hold.values() for x in found]
        lines.append(f"{name:26}{rows}{sum(every) / len(every):10.2f}")
    lines.append(f"{'unguided':26}{alone:{18 * len(HOLDS) + 10}.2f}")
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
