"""One policy for all contexts with a curriculum, against the same without, at equal steps.

    .venv/bin/python evidence/curricula.py [--cmdp pendulum-mass] [--write]

Context-conditioned PPO, the context shown, ten seeds together; each length is a training of its
own, as in `step_policies.py`, whose last weights count. Contexts take turns (domain randomisation),
or a curriculum chooses them from the episodes of the training: nobody judges on the way and none
plays more, so equal lengths are equal steps, all in. V is the mean performance over all contexts on
fresh episodes, the same for all curricula; "worst" is the mean performance of the context where
that is lowest. Writes docs/data/curricula.json; goes on where it was, and prints the table.
`--write` puts it into docs/steps.md.

Notation (shapes): S seeds, N contexts, E episodes.
"""

from __future__ import annotations

import measure

import argparse  # isort: skip
import json
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from mbtl.cmdps import get_cmdp
from mbtl.cmdps.registry import visibility_on_all
from mbtl.cmdps.taught import with_curriculum
from mbtl.curricula import Curriculum, Learnability, Regret
from mbtl.seeds import MATRIX_TRIAL, Purpose, episode_seed, evaluation_seed, training_seed

DOCS = Path(__file__).parents[1] / "docs"
FILE = DOCS / "data/curricula.json"
BEGIN, END = "<!-- begin: table of evidence/curricula.py -->", "<!-- end -->"
SEEDS, EPISODES = 10, 20
LENGTHS = (
    ("cartpole-length", "1/4"), ("pendulum-length", "1"), ("pendulum-mass", "1"),
    ("pendulum-timestep", "1"), ("cartpole-masscart", "1/4"), ("cartpole-masspole", "1/4"),
    ("cartpole-length", "1"), ("cartpole-length", "1/8"), ("cartpole-masscart", "1"),
    ("cartpole-masspole", "1"), ("pendulum-length", "2"), ("pendulum-mass", "2"),
    ("pendulum-timestep", "2"),
)  # fmt: skip
"""CMDPs and shares of a whole training, in this order: some of each before the dear ones."""
TURNS = "turns"
RULES: dict[str, Curriculum | None] = {
    TURNS: None,
    "learnability": Learnability(),
    "learnability of performance": Learnability(of_success=False),
    "regret": Regret(),
}
BOTH = "cartpole-length"
"""Where both kinds of learnability are tried; on Pendulum, where nothing succeeds, they are one."""


def rules_of(cmdp_id: str) -> list[str]:
    """Names of those that differ there."""
    return [name for name in RULES if cmdp_id == BOTH or name != "learnability of performance"]


def ends(cmdp_id: str, share: str, rule: str) -> dict[str, Any]:
    """Steps, and what the policies of all seeds are worth on fresh episodes."""
    import jax

    import mbtl.training.jax as engine

    cmdp = get_cmdp(cmdp_id, visibility=visibility_on_all(cmdp_id))
    assert cmdp.normalisation is not None
    trainer: Any = cmdp.trainer
    if (curriculum := RULES[rule]) is not None:
        trainer = with_curriculum(trainer, curriculum, cmdp.normalisation)
    world, params = trainer.problem(cmdp.space.contexts)
    recipe = engine.multitask_recipe("ppo", type(world.env).__name__)
    n = len(cmdp.space.contexts)
    steps = round((cmdp.preset("paper").timesteps or 0) * float(Fraction(share)))
    seeds = [training_seed(seed, MATRIX_TRIAL, n) for seed in range(SEEDS)]
    begin = time.process_time()
    training = engine.train_multitask(world, recipe, seeds, params, steps, judging=False)
    past = training.state.copies.past
    top = None if past is None else np.sort(np.asarray(past.played), axis=1)[:, -n // 10 :]
    plain, performance = world if curriculum is None else engine.Solo(world.env), []
    for seed in range(SEEDS):
        play = evaluation_seed(seed, MATRIX_TRIAL, Purpose.REPORT)
        numbers = [episode_seed(play, e) for e in range(EPISODES)]
        own = jax.tree.map(lambda x, seed=seed: x[seed : seed + 1], training.state.weights)
        found = engine.evaluate_multitask(plain, recipe, own, params, numbers)[0]
        performance.append(cmdp.normalisation.normalise(found).mean(axis=1))
    each = np.array(performance)
    return {
        "share": share,
        "rule": rule,
        "steps": int(training.updates) * recipe.update_length,
        "V": each.mean(axis=1).round(4).tolist(),
        "worst": each.min(axis=1).round(4).tolist(),
        "of the tenth played most": None
        if top is None or past is None
        else (top.sum(axis=1) / np.asarray(past.played).sum(axis=1)).round(3).tolist(),
        "processor_seconds": round(time.process_time() - begin, 1),
    }


def difference(ours: list[float], theirs: list[float]) -> str:
    """Mean over seeds of what is paired, with its 95 % interval by Student's t."""
    from scipy.stats import t

    gap = np.array(ours) - np.array(theirs)
    half = t.ppf(0.975, len(gap) - 1) * gap.std(ddof=1) / np.sqrt(len(gap))
    return f"{gap.mean():+.3f} [{gap.mean() - half:+.3f}, {gap.mean() + half:+.3f}]"


def table(kept: dict[str, list[dict[str, Any]]]) -> list[str]:
    """By CMDP and length; only what has all its rules."""
    columns = [
        "CMDP", "trained for", "million steps", "V, contexts in turn", "worst context",
        *(f"{rule}: {what}" for rule in ("learnability", "regret")
          for what in ("V less that", "worst context less that")),
    ]  # fmt: skip
    lines = ["| " + " | ".join(columns) + " |", "|---" * len(columns) + "|"]
    for cmdp_id, rows in sorted(kept.items()):
        for share in sorted({row["share"] for row in rows}, key=Fraction):
            by_rule = {row["rule"]: row for row in rows if row["share"] == share}
            if set(by_rule) != set(rules_of(cmdp_id)):
                continue
            turns = by_rule[TURNS]
            cells = [f"{share} whole", f"{turns['steps'] / 1e6:.2f}"]
            cells += [f"{np.mean(turns[what]):.3f}" for what in ("V", "worst")]
            for rule in ("learnability", "regret"):
                mine = by_rule[rule]
                assert mine["steps"] == turns["steps"]
                cells += [difference(mine[what], turns[what]) for what in ("V", "worst")]
            lines.append(f"| {cmdp_id} | {' | '.join(cells)} |")
    return lines


def others(kept: dict[str, list[dict[str, Any]]]) -> list[str]:
    """Learnability of performance where there is success, and how uneven episodes were."""
    lines = []
    for cmdp_id, rows in sorted(kept.items()):
        for row in rows:
            turns = [r for r in rows if r["share"] == row["share"] and r["rule"] == TURNS]
            if row["rule"] == TURNS or not turns:
                continue
            gaps = [difference(row[what], turns[0][what]) for what in ("V", "worst")]
            tenth = np.mean(row["of the tenth played most"])
            lines.append(
                f"{cmdp_id}, {row['share']} whole, {row['rule']}: V {gaps[0]}, worst {gaps[1]}; "
                f"{tenth:.0%} of the episodes in the tenth of the contexts played most"
            )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cmdp", action="append")
    parser.add_argument("--write", action="store_true", help="put the table into docs/steps.md")
    args = parser.parse_args()
    kept: dict[str, list[dict[str, Any]]] = json.loads(FILE.read_text()) if FILE.is_file() else {}
    for cmdp_id, share in () if args.write else LENGTHS:
        for rule in rules_of(cmdp_id) if cmdp_id in (args.cmdp or dict(LENGTHS)) else ():
            done = kept.setdefault(cmdp_id, [])
            if any((one["share"], one["rule"]) == (share, rule) for one in done):
                continue
            done.append(found := ends(cmdp_id, share, rule))
            FILE.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
            measure.note(
                f"{cmdp_id}, {share} of a training, {rule}: V {np.mean(found['V']):.3f}, worst "
                f"{np.mean(found['worst']):.3f}, {found['processor_seconds']} s"
            )
    lines = table(kept)
    print("\n".join([*lines, "", *others(kept)]))
    if args.write:
        page = DOCS / "steps.md"
        head, rest = page.read_text(encoding="utf-8").split(BEGIN)
        text = "\n".join([head + BEGIN, "", *lines, "", END + rest.split(END, 1)[1]])
        page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
