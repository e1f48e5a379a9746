"""What a policy learns from few episodes in SUMO, one choice at a time.

The ramp: whose rewards an action is credited with, and how far it looks. With the paper's values,
credited with what its own car is given until it leaves, or with what the team earns until the end,
as in the paper; near-sighted, as the preset `standard`; and so from samples of the Gaussian instead
of applied accelerations. Signals: the paper's network with a quarter of its gradient steps, the
small one of the preset `standard`, that with observations turned by quarters (which is the preset),
and so without a falling learning rate. All else is that preset's. Scores are those of fresh
episodes in the context trained on and, in brackets, the mean over the contexts of the others; on
the ramp after the score of nobody advised.

example: python evidence/sumo_learning.py --cmdp ramp-acc     # a quarter of an hour of a core
"""

from __future__ import annotations

from dataclasses import replace
from statistics import fmean
from typing import Any

import measure
from learning import trainings
from measure import digits
from traffic_checks import unguided

CONTEXTS = {
    "ramp-acc": ("hold", (2.0, 10.0, 25.0)),
    "ramp-vel": ("hold", (2.0, 10.0, 25.0)),
    "signal-inflow": ("inflow", (1000.0, 2000.0, 2450.0)),
}
PAPER_STEPS = 200
"""Per episode, of the paper's network; the paper's own are 800."""


def ways(cmdp: Any, episodes: int, eval_episodes: int) -> dict[str, Any]:
    """Trainers by name."""
    alike: dict[str, Any] = {"episodes": episodes, "eval_episodes": eval_episodes}
    standard = replace(cmdp.trainer_for("standard"), checkpoint="final", **alike)
    if cmdp.family == "signal":
        paper = cmdp.trainer_for("paper").hyperparameters
        small = standard.hyperparameters
        as_seen = {name: value for name, value in small.items() if name != "replay_buffer_class"}
        steady = {**small, "learning_rate": paper["learning_rate"]}
        kinds = {
            "the paper's network": {**paper, "gradient_steps": PAPER_STEPS},
            "a small one": as_seen,
            "that, turned": small,
            "turned, steady rate": steady,
        }
        return {name: replace(standard, hyperparameters=kind) for name, kind in kinds.items()}
    paper = replace(cmdp.trainer_for("paper"), checkpoint="final", **alike)
    found = {
        "own rewards": replace(paper, credit="own"),
        "the team's": replace(paper, credit="team"),
        "the team's, near-sighted": standard,
    }
    if standard.clip_actions:
        found["near-sighted, samples"] = replace(standard, clip_actions=False)
    return found


def alone(trainer: Any, context: Any) -> float:
    """Mean score of traffic without advice."""
    scores = []
    env = trainer.make_env(context)
    for seed in range(trainer.eval_episodes):
        unguided(env, seed)
        scores.append(env.score)
    env.close()
    return digits(fmean(scores), 3)


def main() -> None:
    """Train, evaluate and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--cmdp", choices=tuple(CONTEXTS), default="ramp-acc")
    parser.add_argument("--episodes", type=int, default=60, help="per training")
    parser.add_argument("--eval-episodes", type=int, default=4, help="per policy and context")
    parser.add_argument("--seeds", type=int, default=2, help="trainings per way and context")
    args = parser.parse_args()
    from mbtl.problems import get_cmdp

    score = "paper" if args.cmdp.startswith(("eco", "signal")) else None
    cmdp = get_cmdp(args.cmdp, engine="sumo", score=score)
    axis, values = CONTEXTS[args.cmdp]
    contexts = [{axis: value} for value in values]
    trainers = ways(cmdp, args.episodes, args.eval_episodes)
    document: dict[str, Any] = {"cmdp": args.cmdp, "episodes": args.episodes, "ways": {}}
    lines = [f"{args.cmdp}, {args.episodes} episodes: scores by {axis} trained on"]
    if cmdp.family.startswith("ramp"):
        document["alone"] = alone(next(iter(trainers.values())), contexts[-1])
        lines.append(f"{'nobody advised':26}{document['alone']:9.2f}")
    for name, trainer in trainers.items():
        done = list(trainings(name, trainer, contexts, args.seeds))
        own = [digits(one.own, 3) for one in done]
        others = [digits(one.others, 3) for one in done]
        document["ways"][name] = {"own": own, "others": others}
        rows = "  ".join(f"{mine:.2f} ({rest:.2f})" for mine, rest in zip(own, others, strict=True))
        lines.append(f"{name:26}{fmean(own):9.2f} ({fmean(others):.2f})   {rows}")
    document["machine"] = measure.machine("libsumo", "sb3_contrib")
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
