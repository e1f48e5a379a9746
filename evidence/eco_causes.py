"""Why does a controller of eco-driving hardly beat no controller, and which one does?

Parts, each a table of docs/eco-driving.md; differences to unguided traffic are paired by seed and
come with 95 % intervals. Every line has CO2 [g] and stops of a trip, completed cars per hour, and
`road`, metres driven per second on the road with feeders and unfinished trips, beside the score.

    rules     hand-written controllers, no training; and how the reward of a trip and the score are
              related over them
    search    the best `glide` rule that a cross-entropy search finds on the score, per context
    axes      one `glide` rule for all contexts, on every fifth context of each axis
    matrices  how many policies of the shipped matrices beat unguided traffic; nothing is played
    training  PPO with one change at a time: reward, first action, exploration, actions, the rule
              to begin with; also before the first update
    standard  policies of a preset on every tenth context of some axes, each in its own context;
              also before the first update and at shares of the training (whole road and rewards are
              not measured)

example: python evidence/eco_causes.py --part rules
"""

from __future__ import annotations

import measure  # first: threads

import time  # isort: skip
from argparse import Namespace  # isort: skip
from pathlib import Path  # isort: skip
from typing import Any  # isort: skip

import numpy as np
from eco_play import (
    GLIDE,
    HARD,
    accelerate,
    any_rule,
    capped,
    glide,
    never_again,
    row_of,
    run,
    searched,
)
from measure import digits, note

NOMINAL = {"penetration": 0.2, "inflow": 400.0, "green": 35.0}


def at(**changed: float) -> dict[str, float]:
    return {**NOMINAL, **changed}


CONTEXTS = {
    "nominal": at(),
    "green 6 s": at(green=6.0),
    "green 16 s": at(green=16.0),
    "green 26 s": at(green=26.0),
    "green 50 s": at(green=50.0),
    "inflow 200": at(inflow=200.0),
    "inflow 1000": at(inflow=1000.0),
    "inflow 2000": at(inflow=2000.0),
    "penetration .04": at(penetration=0.04),
    "penetration .4": at(penetration=0.4),
    "penetration 1": at(penetration=1.0),
}
RULES = {
    "always accelerate": row_of(accelerate, HARD),
    "keep the speed": row_of(accelerate, 0.0),
    "10 m/s at most": row_of(capped, 10.0),
    "never start again": row_of(never_again, 0.5),
    "glide": row_of(glide, 2.0, 1.0, 2.0, 0.0, 300.0, 20.0, -1.0),
    "glide, slow first": row_of(glide, 2.0, 0.7, 2.0, 0.0, 300.0, 20.0, -1.0),
    "glide, try for green": row_of(glide, 1.0, 0.55, 1.7, -2.7, 250.0, 7.5, 2.0),
}
BEST = "glide, try for green"
ECO = ("eco-green", "eco-inflow", "eco-penetration")
SEARCHED = ("nominal", "green 16 s", "green 26 s", "inflow 1000", "penetration .4", "penetration 1")
FRESH = 1000  # seeds of evaluations begin here; those of the search at 0


def line(name: str, found: Any, base: Any, k: int) -> tuple[str, dict[str, Any]]:
    """One line of a table, for context `k`."""
    apart = found["score"][k] - base["score"][k]
    half = 1.96 * apart.std(ddof=1) / len(apart) ** 0.5
    mean = {
        key: digits(float(found[key][k].mean()), 4)
        for key in ("score", "co2", "stops", "throughput", "system", "step_reward")
        if key in found
    }
    record = {**mean, "difference": digits(float(apart.mean()), 3), "half_width": digits(half, 2)}
    text = (
        f"| {name} | {mean['score']:.2f} | {apart.mean():+.2f} +- {half:.2f} | {mean['co2']:.0f} "
        f"| {mean['stops']:.2f} | {mean['throughput']:.0f} | "
        + (f"{mean['system']:.2f} |" if "system" in mean else "|")
    )
    return text, record


_COLUMNS = ("", "score m/s", "less unguided", "CO2 g", "stops", "cars/h", "road m/s")
HEAD = f"| {' | '.join(_COLUMNS)} |\n{'|---' * len(_COLUMNS)}|"


def rules(seeds: int) -> tuple[list[str], Any]:
    """Hand-written controllers in all contexts, and what the reward says of them."""
    plays: dict[str, dict[str, Any]] = {}
    for name, context in CONTEXTS.items():
        note(f"{name} ...")
        drawn = range(FRESH, FRESH + seeds)
        base = run(None, [context], drawn)
        found = run(any_rule, [context] * len(RULES), drawn, np.stack(list(RULES.values())))
        for rule, k in [("unguided", None), *((rule, k) for k, rule in enumerate(RULES))]:
            one = base if k is None else {key: x[[k]] for key, x in found.items()}
            for key, x in one.items():
                plays.setdefault(rule, {}).setdefault(key, []).append(x)
    plays = {
        rule: {key: np.concatenate(x) for key, x in each.items()} for rule, each in plays.items()
    }
    base = plays["unguided"]
    lines, document = [], {}
    for k, context in enumerate(CONTEXTS):
        lines += ["", context, HEAD]
        for name, found in plays.items():
            text, document[f"{context}: {name}"] = line(name, found, base, k)
            lines.append(text)
    return lines + reward(plays), document


def reward(plays: dict[str, Any]) -> list[str]:
    """Per context, over rules that let traffic flow: rewards of a trip beside the score."""
    names = [n for n in plays if n not in ("keep the speed", "never start again")]
    lines = ["", "reward of a trip of an agent (score); correlation of the two over these rules"]
    lines.append("| | " + " | ".join(names) + " | correlation |")
    lines.append("|---" * (len(names) + 2) + "|")
    for k, context in enumerate(CONTEXTS):
        pairs = [(plays[n]["trip_return"][k].mean(), plays[n]["score"][k].mean()) for n in names]
        together = np.corrcoef(np.array(pairs).T)[0, 1]
        cells = " | ".join(f"{a:.0f} ({b:.2f})" for a, b in pairs)
        lines.append(f"| {context} | {cells} | {together:+.2f} |")
    return lines


def search(rounds: int, seeds: int) -> tuple[list[str], Any]:
    """The best `glide` of each context, judged on fresh seeds."""
    contexts, drawn = [CONTEXTS[name] for name in SEARCHED], range(FRESH, FRESH + seeds)
    numbers = searched(contexts, rounds)
    base = run(None, contexts, drawn)
    found = run(any_rule, contexts, drawn, np.insert(numbers, 0, 0.0, axis=1))
    lines, document = [HEAD], {}
    for k, name in enumerate(SEARCHED):
        for way, each in ((f"{name}, unguided", base), (f"{name}, found", found)):
            text, document[way] = line(way, each, base, k)
            lines.append(text)
        document[name] = dict(zip(GLIDE, numbers[k].round(2).tolist(), strict=True))
        lines.append(f"| | {document[name]} |")
    return lines, document


def axes(seeds: int) -> tuple[list[str], Any]:
    """Means over every fifth context of an axis; intervals are over seeds, which contexts share."""
    from mbtl.problems import get_cmdp

    lines, document = [HEAD], {}
    for cmdp in ECO:
        note(f"{cmdp} ...")
        contexts = [{**NOMINAL, **context} for context in get_cmdp(cmdp).space.contexts[4::5]]
        drawn = range(FRESH, FRESH + seeds)
        base = run(None, contexts, drawn)
        found = run(any_rule, contexts, drawn, RULES[BEST])
        base, found = (
            {key: x.mean(axis=0, keepdims=True) for key, x in each.items()}
            for each in (base, found)
        )
        for way, each in (("unguided", base), (BEST, found)):
            text, document[f"{cmdp}: {way}"] = line(f"{cmdp}: {way}", each, base, 0)
            lines.append(text)
    return lines, document


def matrices() -> tuple[list[str], Any]:
    """Entries beside the reference row, which has the same episodes."""
    from scipy import stats

    from mbtl.zoo.benchmark import compare, load_matrix

    names = ("unguided", "own policy", "any policy", "best one policy", "oracle transfer")
    shares = ("own policy beats unguided", "any policy does", "MBTL's fifteen over unguided")
    lines = ["| | " + " | ".join((*names, *shares)) + " |", "|---" * 9 + "|"]
    document = {}
    for cmdp in ECO:
        matrix = load_matrix(cmdp)
        rows = np.asarray(matrix.returns, float)
        alone = np.asarray(matrix.references["unguided"], float)
        alone = alone.reshape(len(rows), -1, rows.shape[2]).mean(axis=1)
        own = np.diagonal(rows, axis1=1, axis2=2)
        means = (
            alone.mean(),
            own.mean(),
            rows.mean(),
            rows.mean(axis=2).max(axis=1).mean(),
            rows.max(axis=1).mean(),
        )
        wins = ((own > alone).mean(), (rows > alone[:, None]).mean())
        fifteen = [run.performance[-1] for run in compare(["mbtl"], [matrix], 15, seeds=1).results]
        fresh = np.asarray(matrix.references["unguided"], float)[:, 1].mean(axis=1)
        gain = matrix.bounds.denormalise(np.array(fifteen)) - fresh  # by seed, same episodes
        half = stats.t.ppf(0.975, len(gain) - 1) * gain.std(ddof=1) / len(gain) ** 0.5
        numbers = (*means, *wins, gain.mean(), half)
        document[cmdp] = [digits(float(x), 3) for x in numbers]
        cells = [f"{x:.2f}" for x in means] + [f"{100.0 * x:.0f} %" for x in wins]
        cells.append(f"+{gain.mean():.2f} +- {half:.2f}")
        lines.append(f"| {cmdp} | {' | '.join(cells)} |")
    return lines, document


def training(names: list[str], ways: str, episodes: int, seeds: int) -> tuple[list[str], Any]:
    """Policies before and after training, by way; of the first and of the last weights."""
    from eco_training import FRESH as FIRST
    from eco_training import SEEDS, WAYS, acting, trained

    lines, document = [], {}
    for name in names:
        note(f"{name}: training ...")
        chosen = WAYS[ways]
        before, after = trained(CONTEXTS[name], ways, episodes)
        base = run(None, [CONTEXTS[name]], range(FIRST, FIRST + seeds))
        lines += ["", name, HEAD, line("unguided", base, base, 0)[0]]
        for when, weights in (("untrained", before), ("trained", after)):
            found = acting(weights, CONTEXTS[name], seeds, ways)
            sampled = found["sampled"].mean(axis=1)
            for k, way in enumerate(way for way in chosen for _ in range(SEEDS)):
                one = {key: x[[k]] for key, x in found.items()}
                text, record = line(f"{way}, {when}", one, base, 0)
                lines.append(f"{text} by sampled actions {sampled[k]:.2f}")
                document[f"{name}: {way} {when} {k % SEEDS}"] = record | {"sampled": sampled[k]}
    return lines, document


def standard(asked: Namespace) -> tuple[list[str], Any]:
    """Policies in their own contexts, the axes' in one program; intervals are over episodes."""
    from dataclasses import replace

    from eco_training import measures

    from mbtl.problems import get_cmdp
    from mbtl.zoo.cmdps.engines import EnvFactory, TwinProblem

    every, trainings = asked.every, asked.trainings
    axes = {name: get_cmdp(name, engine="jax", score="paper") for name in asked.axes}
    grids = {name: cmdp.space.contexts[every // 2 :: every] for name, cmdp in axes.items()}
    contexts = [at(**context) for grid in grids.values() for context in [*grid] * trainings]
    other = {"rows": asked.rows, "anneal": asked.anneal}
    other = {name: value for name, value in other.items() if value}
    changed = {"hyperparameters": other, "episodes": asked.length}
    changed = {name: value for name, value in changed.items() if value}
    trainer: Any = axes[asked.axes[0]].trainer_for(asked.preset, **changed)
    all_axes = EnvFactory("mbtl.zoo.cmdps.traffic.eco:Eco")
    trainer = replace(trainer, problem=TwinProblem(trainer.problem.problem, all_axes))
    note(f"{len(contexts)} trainings ...")
    start = time.process_time()
    policies = trainer.train_many(
        contexts,
        range(len(contexts)),
        on_progress=lambda done: note(f"{done.step:,} of {done.total:,} {done.unit}"),
        keep=(*(f"last@{share}" for share in asked.shares), trainer.checkpoint),
        state=asked.partial,
    )
    minutes = (time.process_time() - start) / 60.0
    ways = {
        "unguided": None,
        "untrained": [trainer.untrained(contexts[0])] * len(contexts),
        **{f"after {share}": policies[f"last@{share}"] for share in asked.shares},
        "trained": policies[trainer.checkpoint],
    }
    world, params = trainer.problem(contexts)
    plays = {way: measures(world, params, each, asked.seeds) for way, each in ways.items()}
    apart = (plays["trained"]["score"] - plays["unguided"]["score"]).mean(axis=1)

    lines, document = [HEAD], {"processor minutes": digits(minutes, 3)}
    first = 0
    for name, grid in grids.items():
        some = slice(first, first + len(grid) * trainings)
        first = some.stop
        for way in ways:
            mean, base = (
                {key: x[some].mean(axis=0, keepdims=True) for key, x in plays[who].items()}
                for who in (way, "unguided")
            )
            text, document[f"{name}: {way}"] = line(f"{name}: {way}", mean, base, 0)
            lines.append(text)
        lines.append(f"| better than unguided: {(apart[some] > 0).mean():.0%} |")
        each = [f"{x:+.2f}" for x in apart[some]]
        lines.append(f"| in {[*map(dict, grid)]} x {trainings}: {', '.join(each)} |")
    lines.append(f"{minutes:.1f} processor minutes for {len(contexts)} trainings")
    return lines, document


def main() -> None:
    """Play and print."""
    parser = measure.parser(__doc__)
    parts = ("rules", "search", "axes", "matrices", "training", "standard")
    parser.add_argument("--part", choices=parts, default="rules")
    parser.add_argument("--seeds", type=int, default=32, help="episodes per line")
    parser.add_argument("--rounds", type=int, default=8, help="of the search")
    parser.add_argument("--episodes", type=int, default=240, help="of a training")
    parser.add_argument(
        "--contexts", nargs="+", choices=list(CONTEXTS), default=["inflow 1000"], help="to train in"
    )
    parser.add_argument(
        "--ways",
        choices=("first action", "exploration", "speeds", "glide"),
        default="first action",
        help="to train",
    )
    parser.add_argument("--preset", default="standard", help="whose policies are trained")
    parser.add_argument("--axes", nargs="+", choices=ECO, default=ECO, help="of the preset")
    parser.add_argument("--every", type=int, default=10, help="contexts of an axis, of the preset")
    parser.add_argument("--trainings", type=int, default=1, help="per context, of the preset")
    parser.add_argument("--rows", type=int, help="at most so many decisions in an update")
    parser.add_argument("--anneal", action="store_true", help="the learning rate falls to 0")
    parser.add_argument("--length", type=int, help="episodes of a training, of the preset")
    parser.add_argument("--shares", nargs="+", default=[], help="of a training to play, as 1/4")
    parser.add_argument("--partial", type=Path, help="file by which a part `standard` goes on")
    args = parser.parse_args()
    if args.part == "rules":
        lines, document = rules(args.seeds)
    elif args.part == "search":
        lines, document = search(args.rounds, args.seeds)
    elif args.part == "axes":
        lines, document = axes(args.seeds)
    elif args.part == "matrices":
        lines, document = matrices()
    elif args.part == "standard":
        lines, document = standard(args)
    else:
        lines, document = training(args.contexts, args.ways, args.episodes, args.seeds)
    whole = {"part": args.part, "lines": document, "machine": measure.machine("jax")}
    measure.show(whole, lines, as_json=args.json)


if __name__ == "__main__":
    main()
