"""One policy for all contexts with a curriculum, against the same without, at equal steps.

    .venv/bin/python evidence/curricula.py [--cmdp pendulum-mass] [--write]

Context-conditioned PPO, the context shown, all seeds together; each length is a training of its
own, as in `step_policies.py`, whose last weights count. Domain randomisation is there twice:
contexts in turn, as everywhere else, and drawn evenly in the order of a curriculum. A curriculum
chooses from the episodes of the training: nobody judges on the way and none plays more, so equal
lengths are equal steps, all in. V is the mean performance over all contexts on fresh episodes, the
same for all; "worst" is the mean performance of the context where that is lowest. Writes
docs/data/curricula.json; goes on where it was, and prints the table. `--write` puts it into
docs/steps.md.

Notation (shapes): S seeds, N contexts, E episodes.
"""

from __future__ import annotations

import measure
import pages

import argparse  # isort: skip
import json
import time
from fractions import Fraction
from typing import Any

import numpy as np

from mbtl.cmdps import get_cmdp
from mbtl.cmdps.registry import visibility_on_all
from mbtl.cmdps.taught import with_curriculum
from mbtl.curricula import Curriculum, Learnability, Regret
from mbtl.seeds import MATRIX_TRIAL, Purpose, episode_seed, evaluation_seed, training_seed

FILE = pages.DOCS / "data/curricula.json"
EPISODES = 20
LENGTHS = (
    ("cartpole-length", "1/4", 10), ("pendulum-length", "1", 10), ("pendulum-mass", "1", 5),
    ("cartpole-masscart", "1/4", 5), ("pendulum-timestep", "1", 5), ("cartpole-masspole", "1/4", 5),
    ("cartpole-length", "1", 3), ("cartpole-masscart", "1", 3), ("cartpole-masspole", "1", 3),
)  # fmt: skip
"""CMDPs, shares of a whole training, and seeds; the dear ones last."""
TURNS, EVEN = "turns", "even"
RULES: dict[str, Curriculum | None] = {
    TURNS: None,
    EVEN: Learnability(uniform=1.0),
    "learnability": Learnability(),
    "regret": Regret(),
    "learnability of performance": Learnability(of_success=False),
}
"""`EVEN` has the order of a curriculum and no preference: the others differ from it by their
weights alone."""
CHOOSING = ("learnability", "regret")
ONCE = {("cartpole-length", "1/4"): "learnability of performance"}
"""Tried there, too; on Pendulum, where nothing succeeds, it is learnability."""


def ends(cmdp_id: str, share: str, n_seeds: int, rule: str) -> dict[str, Any]:
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
    seeds = [training_seed(seed, MATRIX_TRIAL, n) for seed in range(n_seeds)]
    begin = time.process_time()
    training = engine.train_multitask(world, recipe, seeds, params, steps, judging=False)
    past = training.state.copies.past
    top = None if past is None else np.sort(np.asarray(past.played), axis=1)[:, -n // 10 :]
    plain, performance = world if curriculum is None else engine.Solo(world.env), []
    for seed in range(n_seeds):
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


Kept = dict[str, list[dict[str, Any]]]


def table(kept: Kept) -> list[str]:
    """By CMDP and length; only what has all its rules."""
    columns = [
        "CMDP", "trained for", "million steps", "seeds", "V, in turn", "V, even", "worst, even",
        "V: even less in turn", *(f"V: {rule} less even" for rule in CHOOSING),
        *(f"worst: {rule} less even" for rule in CHOOSING),
    ]  # fmt: skip
    lines = ["| " + " | ".join(columns) + " |", "|---" * len(columns) + "|"]
    for (cmdp_id, share), found in by_length(kept).items():
        if not found.keys() >= {TURNS, EVEN, *CHOOSING}:
            continue
        turns, even = found[TURNS], found[EVEN]
        assert len({row["steps"] for row in found.values()}) == 1
        cells = [f"{share} whole", f"{even['steps'] / 1e6:.2f}", str(len(even["V"]))]
        cells += [f"{np.mean(x):.3f}" for x in (turns["V"], even["V"], even["worst"])]
        cells.append(difference(even["V"], turns["V"]))
        for what in ("V", "worst"):
            cells += [difference(found[rule][what], even[what]) for rule in CHOOSING]
        lines.append(f"| {cmdp_id} | {' | '.join(cells)} |")
    return lines


def uneven(kept: Kept) -> list[str]:
    """How many of the episodes were in the contexts played most; V on the seeds of `steps.py`."""
    lines = []
    for (cmdp_id, share), found in by_length(kept).items():
        for rule, row in found.items():
            first = np.mean(row["V"][:3])
            line = f"{cmdp_id}, {share} whole, {rule}: V of seeds 0 to 2 {first:.3f}"
            if rule != TURNS:
                line += f"; a tenth got {np.mean(row['of the tenth played most']):.1%} of episodes"
            lines.append(line)
    return lines


def by_length(kept: Kept) -> dict[tuple[str, str], dict[str, dict[str, Any]]]:
    """Rows by rule, for each CMDP and length in the order of the table."""
    keys = {(cmdp_id, row["share"]) for cmdp_id, rows in kept.items() for row in rows}
    return {
        (cmdp_id, share): {row["rule"]: row for row in kept[cmdp_id] if row["share"] == share}
        for cmdp_id, share in sorted(keys, key=lambda key: (key[0], Fraction(key[1])))
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cmdp", action="append")
    parser.add_argument("--write", action="store_true", help="put the table into docs/steps.md")
    args = parser.parse_args()
    kept: Kept = json.loads(FILE.read_text()) if FILE.is_file() else {}
    for cmdp_id, share, n_seeds in () if args.write else LENGTHS:
        extra = ONCE.get((cmdp_id, share))
        for rule in (TURNS, EVEN, *CHOOSING, *([extra] if extra else [])):
            if args.cmdp and cmdp_id not in args.cmdp:
                continue
            done = kept.setdefault(cmdp_id, [])
            if any((one["share"], one["rule"]) == (share, rule) for one in done):
                continue
            done.append(found := ends(cmdp_id, share, n_seeds, rule))
            FILE.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
            measure.note(
                f"{cmdp_id}, {share} of a training, {rule}: V {np.mean(found['V']):.3f}, worst "
                f"{np.mean(found['worst']):.3f}, {found['processor_seconds']} s"
            )
    lines = table(kept)
    print("\n".join([*lines, "", *uneven(kept)]))
    if args.write:
        pages.fill("steps.md", "table", lines)


if __name__ == "__main__":
    main()
