"""A claim of the paper, and the words of a verdict on it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mbtl.zoo.reproduction.item import Numbers

# ---- a claim of the paper, and the words of a verdict on it ----------------------------------


REPRODUCED, PARTLY, NOT, OPEN = "reproduced", "partly", "not reproduced", "not testable"
NO_EVIDENCE = "no evidence"
"""The numbers are as the paper says, and as much so where the cause it names is missing."""


@dataclass(frozen=True)
class Claim:
    """One claim.

    Attributes:
        title: in a few words.
        paper: what the paper says.
        rule: when it counts as reproduced, and when as partly.
        found: what was found, with numbers.
        verdict: "reproduced", "partly", "not reproduced", "not testable" or `NO_EVIDENCE`.
        figure: stem of the figure to look at; empty if there is none.
        control: what is found where the cause that the claim names is missing; empty: there is no
            such control.
    """

    title: str
    paper: str
    rule: str
    found: str
    verdict: str
    figure: str = ""
    control: str = ""

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return asdict(self)


def verdict(full: bool, part: bool, control: bool = False) -> str:
    """Of a claim that can be tested; `control`: whether its control does as well."""
    if control and (full or part):
        return NO_EVIDENCE
    return REPRODUCED if full else PARTLY if part else NOT


# Claims about theory and matrices: search space, gap, heatmaps, rivals, the process itself


def of_elimination(numbers: Numbers) -> list[Claim]:
    """Of the item `elimination`."""
    some = numbers["cmdps"]
    if not some:
        return []
    shortest = min(len(one["rate"]) for one in some.values())
    mean = np.mean([one["rate"][:shortest] for one in some.values()], axis=0)[1:]
    root, halving = (np.array(numbers[key])[1:shortest] for key in ("sqrt", "halving"))
    if not len(mean):
        return []
    below, faster = int((mean <= root).sum()), int((mean <= halving).sum())
    each = sum(
        bool((np.array(one["rate"])[1:shortest] <= root).mean() >= 0.9) for one in some.values()
    )
    evens = [one["control_rate"][1:shortest] for one in some.values() if "control_rate" in one]
    even = int((np.mean(evens, axis=0) <= root).sum()) if evens else 0
    return [
        *_regret(list(some.values())),
        Claim(
            "Search space shrinks as the corollaries assume",
            "It shrinks at least as fast as 1/sqrt(k), up to as fast as halving.",
            "Reproduced: in the mean over CMDPs it is at most 1/sqrt(k) at every k from 2. Partly: "
            "at half of them.",
            f"at most 1/sqrt(k) at {below} of {len(mean)} k, at most halving at {faster}; at nine "
            f"k of ten on {each} of {len(some)} CMDPs",
            verdict(below == len(mean), 2 * below >= len(mean), even >= below),
            "11-elimination",
            f"Greedy, which fits no model: at {even} of {len(mean)} k",
        ),
    ]


def _regret(some: list[dict[str, Any]]) -> list[Claim]:
    """R_K grows like a power of K; below 1 it is sublinear."""

    def power(key: str) -> tuple[list[float], int]:
        totals = [np.cumsum(one[key]) for one in some if key in one and len(one[key]) > 2]
        totals = [total[1:] for total in totals if total[1] > 0.0]
        slopes = [np.polyfit(np.log(np.arange(len(t)) + 2.0), np.log(t), 1)[0] for t in totals]
        return [float(x) for x in slopes], sum(slope < 1.0 for slope in slopes)

    (ours, below), (even, same) = power("regret"), power("control_regret")
    if not ours:
        return []
    return [
        Claim(
            "Sublinear regret",
            "The regret R_K, by which K picks add less than the best would have, grows slower "
            "than K.",
            "Reproduced: the exponent of R_K in K, from k = 2 on, is below 1 on nine CMDPs of ten. "
            "Partly: on half of them. The bound itself has constants that nobody knows.",
            f"exponent below 1 on {below} of {len(ours)}, median {np.median(ours):.2f}",
            verdict(below >= 0.9 * len(ours), 2 * below >= len(ours),
                    bool(even) and same * len(ours) >= below * len(even)),
            "11-elimination",
            f"Greedy: on {same} of {len(even)}, median {np.median(even):.2f}" if even else "",
        )
    ]  # fmt: skip


def of_correlation(numbers: Numbers) -> list[Claim]:
    """Of the item `gap-correlation`."""
    every = numbers["cmdps"].items()
    means = {id: one["mean"] for id, one in every if one["mean"] is not None}
    controls = {id: one["control"] for id, one in every}
    groups: tuple[tuple[str, str, str, Callable[[float], bool]], ...] = (
        ("eco", "eco-driving", "above 0.6", lambda r: r > 0.6),
        ("cheetah", "HalfCheetah", "near 0 (within 0.1)", lambda r: abs(r) <= 0.1),
        ("", "all others", "mostly 0.3 to 0.5", lambda r: 0.3 <= r <= 0.5),
    )
    found = []
    for prefix, name, said, holds in groups:
        some = {
            id: r
            for id, r in means.items()
            if (id.startswith(prefix) if prefix else not id.startswith(("eco", "cheetah")))
        }
        title, rule = (
            f"Gap correlation: {name}",
            "Reproduced: it is so in the mean over sources on two thirds of the CMDPs. Partly: on "
            "one.",
        )
        if not some:
            found.append(Claim(title, said, rule, "no matrix so far", OPEN))
            continue
        good = [id for id, r in some.items() if holds(r)]
        without = {id: controls[id] for id in some if controls[id] is not None}
        same = [id for id, r in without.items() if holds(r)]
        found.append(
            Claim(title, f"Correlation of gap and distance {said}.", rule,
                  f"so on {len(good)} of {len(some)}{_span(some.values())}",
                  verdict(3 * len(good) >= 2 * len(some), bool(good), len(same) >= len(good)),
                  "09-gap-correlation",
                  f"{_ALIKE}: on {len(same)}{_span(without.values())}")
        )  # fmt: skip
    return found


def _span(values: Collection[float]) -> str:
    return f" ({min(values):.2f} to {max(values):.2f})" if values else ""


_ALIKE = "policies alike for all sources"
"""Each is worth, everywhere, what a policy is worth there in the mean."""
Holds = Callable[[dict[str, float]], bool]


def of_heatmaps(numbers: Numbers) -> list[Claim]:
    """Of the item `heatmaps`."""
    facts = {id: one["facts"] for id, one in numbers["cmdps"].items()}
    without = {id: one["without"] for id, one in numbers["cmdps"].items()}
    alike = {id: one["control"] for id, one in numbers["cmdps"].items()}
    flat = ("signal-speed", "walker-friction", "cheetah-friction")
    decay = ("cartpole-masscart", "cartpole-length", "pendulum-length")
    trend = "the rank correlation of performance and target is beyond 0.5, with the claim's sign"
    said: tuple[tuple[str, tuple[str, ...], str, str, str, Holds], ...] = (
        ("Heatmaps: signal inflow", ("signal-inflow",),
         "Transfer from low to high inflow is bad.",
         "low to high loses 0.1 or more, and twice as much as high to low",
         "low to high {up:+.3f}, high to low {down:+.3f}",
         lambda f: f["up"] <= -0.1 and f["up"] <= 2 * f["down"]),
        ("Heatmaps: near uniform", flat, "Signal speed and the frictions are near uniform.",
         "deviation between sources at most 0.05", "between sources {by_source:.3f}",
         lambda f: f["by_source"] <= 0.05),
        ("Heatmaps: green phase", ("eco-green",), "Eco-driving is better at long green.",
         trend,
         "rank correlation {target_trend:+.2f}", lambda f: f["target_trend"] > 0.5),
        ("Heatmaps: eco inflow", ("eco-inflow",), "Eco-driving is better at low inflow.",
         trend,
         "rank correlation {target_trend:+.2f}", lambda f: f["target_trend"] < -0.5),
        ("Heatmaps: penetration", ("eco-penetration",), "Penetration is nearly flat.",
         "deviation between targets at most 0.05", "between targets {by_target:.3f}",
         lambda f: f["by_target"] <= 0.05),
        ("Heatmaps: decay with distance", decay,
         "CartPole's cart mass and length and Pendulum's length decay with distance.",
         "far pairs lose 0.05 or more against near ones", "near {near:+.3f}, far {far:+.3f}",
         lambda f: f["far"] <= f["near"] - 0.05),
    )  # fmt: skip
    found = []
    for title, ids, paper, rule, shown, holds in said:
        some = {id: facts[id] for id in ids if id in facts}
        rule = f"Reproduced: {rule}{'' if len(ids) == 1 else ', on all of them. Partly: on some'}."
        if not some:
            found.append(Claim(title, paper, rule, "no matrix so far", OPEN, "05-heatmaps"))
            continue
        good = [id for id, f in some.items() if holds(f)]
        words = "; ".join(f"{id}: {shown.format(**f)}" for id, f in some.items())
        missing = [id for id in ids if id not in some]
        words += f"; without a matrix so far: {', '.join(missing)}" if missing else ""
        if "target" in shown:  # of targets, not of policies: what is there without a policy?
            peers = {id: f for id in some if (f := without[id]) is not None}
            null = "; ".join(f"{f['name']}: {shown.format(**f)}" for f in peers.values())
        elif "source" in shown:  # few differences say little where few CMDPs have many
            peers = {id: f for id, f in facts.items() if id not in ids}
            null = f"so on {sum(map(holds, peers.values()))} of the {len(peers)} other CMDPs"
        else:
            peers = {id: alike[id] for id in some}
            null = f"{_ALIKE}: " + "; ".join(shown.format(**f) for f in peers.values())
        fine = 2 * sum(map(holds, peers.values())) > len(peers) > 0
        found.append(
            Claim(title, paper, rule, words, verdict(len(good) == len(ids), bool(good), fine),
                  "05-heatmaps", null)
        )  # fmt: skip
    return found


def of_rivals(numbers: Numbers) -> list[Claim]:
    """Of the item `multitask-rivals`."""
    rows = [
        row["values"] for row in numbers["rows"] if {"ppo", "moore", "paco"} <= set(row["values"])
    ]
    if not rows:
        return []
    moore = sum(row["moore"]["mean"] < row["ppo"]["mean"] for row in rows)
    paco = sum(row["paco"]["mean"] >= row["ppo"]["mean"] - 1e-4 for row in rows)
    return [
        Claim(
            "PaCo and MOORE on CartPole",
            "MOORE is below its multi-task baseline; PaCo is equal or better at points.",
            "Reproduced: MOORE is below on most CMDPs, PaCo level (to 0.0001) or better on one. "
            "Partly: one of the two.",
            f"MOORE below on {moore} of {len(rows)}, PaCo level or better on {paco}",
            verdict(2 * moore > len(rows) and paco > 0, 2 * moore > len(rows) or paco > 0),
            "10-multitask-rivals",
        )
    ]


def of_gp_study(numbers: Numbers) -> list[Claim]:
    """Of the item `gp-study`."""
    rows = numbers["rows"]
    best = min(rows, key=lambda row: row["rmse"])
    (chosen,) = (r for r in rows if (r["kernel"], r["noise"], r["restarts"]) == ("RBF", 0.001, 15))
    ratio = chosen["rmse"] / best["rmse"]
    return [
        Claim(
            "Choice of the Gaussian process",
            "RBF, noise 0.001 and 15 restarts predict best on synthetic data.",
            "Reproduced: their error is the smallest (to 1 %). Partly: within a tenth of it.",
            f"error {chosen['rmse']:.4f}, {ratio:.2f} times the smallest ({best['kernel']}, noise "
            f"{best['noise']:g}: {best['rmse']:.4f}); three worlds, fitted to the best performance "
            "so far as in the released code",
            verdict(ratio <= 1.01, ratio <= 1.1),
            "13-gp-study",
        )
    ]


# Claims about selection: who is better, by how much, how soon, and whatever the algorithm


_MANY = ("random", "greedy")
_TIE = 1e-9
ORACLE_K = 10

# ---- the table -----------------------------------------------------------------------------------


def _ours(numbers: Numbers) -> list[dict[str, Any]]:
    return [row for row in numbers["rows"] if row["ours"] is not None]


def _mean(row: dict[str, Any], key: str, method: str) -> float:
    return float(row[key][method]["mean"])


def of_table(numbers: Numbers) -> list[Claim]:
    """Of the item `main-table`."""
    rows = [row for row in _ours(numbers) if "greedy" in row["ours"]]
    judges = (_best, _over_single, _many_over_one)
    return [judge(numbers, rows) for judge in judges] if rows else []


def _above_single(group: list[dict[str, Any]], key: str, method: str) -> int:
    """On how many lines a method is above both Independent and Multi-task."""
    return sum(
        _mean(r, key, method)
        > max(_mean(r, key, m) for m in ("independent", "multitask") if m in r[key])
        for r in group
    )


def _over_single(numbers: Numbers, rows: list[dict[str, Any]]) -> Claim:
    every = [row for row in numbers["rows"] if row["published"]]
    ours, paper = _above_single(rows, "ours", "mbtl"), _above_single(every, "published", "mbtl")
    longer = [row for row in rows if "one_policy" in row["ours"]]
    ahead = sum(_mean(r, "ours", "mbtl") > _mean(r, "ours", "one_policy") for r in longer)
    share = paper / max(len(every), 1)
    return Claim(
        "MBTL over Independent and Multi-task",
        f"MBTL is above both on {paper} of {len(every)} CMDPs.",
        "Reproduced: on as large a share of CMDPs. Partly: on more than half.",
        f"on {ours} of {len(rows)}; above one policy for all with K units on {ahead} of "
        f"{len(longer)}",
        verdict(ours >= share * len(rows), 2 * ours > len(rows)),
        "01-main-table-agreement",
    )


def _best(numbers: Numbers, rows: list[dict[str, Any]]) -> Claim:
    def wins(group: list[dict[str, Any]], key: str) -> int:
        return sum(
            all(_mean(r, key, "mbtl") >= _mean(r, key, m) - _TIE for m in _MANY) for r in group
        )

    every = [row for row in numbers["rows"] if row["published"]]
    pooled = numbers["aggregate"]
    better = {m: pooled[m]["mbtl_better"] for m in _MANY if m in pooled}
    count, share = wins(rows, "ours"), wins(every, "published") / max(len(every), 1)
    lead = {
        m: float(np.mean([_mean(r, "ours", "mbtl") - _mean(r, "ours", m) for r in rows]))
        for m in _MANY
    }
    many, ahead = count >= share * len(rows), all(value > 0 for value in lead.values())
    odds = ", ".join(f"{value:.2f} over {name.capitalize()}" for name, value in better.items())
    return Claim(
        "MBTL over Random and Greedy",
        f"MBTL is the best of the three on {wins(every, 'published')} of {len(every)} CMDPs.",
        "Reproduced: best on as large a share of CMDPs, and ahead of both in the mean. Partly: one "
        "of the two.",
        f"best on {count} of {len(rows)}; mean lead {lead['random']:+.4f} over Random, "
        f"{lead['greedy']:+.4f} over Greedy; chance that a run of MBTL is better: {odds}",
        verdict(many and ahead, many or ahead),
        "01-main-table-aggregate",
    )


def _many_over_one(numbers: Numbers, rows: list[dict[str, Any]]) -> Claim:
    above = _above_single
    every = [row for row in numbers["rows"] if row["published"]]
    counts = {m: above(rows, "ours", m) for m in _MANY}
    paper = {m: above(every, "published", m) for m in _MANY}
    full = all(counts[m] / len(rows) >= paper[m] / max(len(every), 1) for m in _MANY)
    part = all(counts[m] > len(rows) / 2 for m in _MANY)
    domains = []
    for domain in ("traffic", "control"):
        some = [row for row in rows if row["domain"] == domain]
        if some:
            said = " and ".join(f"{m.capitalize()} {above(some, 'ours', m)}" for m in _MANY)
            domains.append(f"{domain}: {said} of {len(some)}")
    return Claim(
        "Random and Greedy over Independent and Multi-task",
        f"Several policies beat one: Random on {paper['random']}, Greedy on {paper['greedy']} of "
        f"{len(every)} CMDPs.",
        "Reproduced: on as large a share of CMDPs. Partly: on more than half.",
        "; ".join(domains),
        verdict(full, part),
        "01-main-table-agreement",
    )


# ---- sample efficiency ---------------------------------------------------------------------------

_TEXT = {"control": 43.0, "traffic": 30.0}


def of_efficiency(numbers: Numbers) -> list[Claim]:
    """Of the item `sample-complexity`."""
    found = []
    for domain, said in _TEXT.items():
        ours, paper = numbers["best"][f"{domain}_ours"], numbers["best"][f"{domain}_published"]
        missing = [
            row["cmdp"] for row in numbers["rows"] if row["domain"] == domain and not row["ours"]
        ]
        table = f"; its own table has {paper['value']:.0f} ({paper['of']})" if paper else ""
        text = f"up to {said:.0f} times fewer trainings{table}"
        rule = "Reproduced: the largest M/k* is the text's or more. Partly: half of that."
        control = numbers["best"][f"{domain}_control"]
        even = 0.0 if control is None else control["value"]
        title = f"Sample efficiency in {domain}"
        if ours is None:
            found.append(Claim(title, text, rule, "no matrix whose k* is reached", OPEN))
            continue
        some = [row for row in numbers["rows"] if row["domain"] == domain and row["ours"]]
        never = [row["cmdp"] for row in some if row["ours"]["mean"] is None]
        known = f"largest M/k*: {ours['value']:.1f} on {ours['of']}"
        if never:
            known += f"; on {len(never)} of {len(some)} not every seed gets there"
        if missing:
            known += f"; without a matrix so far: {', '.join(missing)}"
        found.append(
            Claim(title, text, rule, known,
                  verdict(ours["value"] >= said, ours["value"] >= said / 2,
                          even >= ours["value"]),
                  "02-sample-complexity",
                  "" if control is None else
                  f"the better of Random and Greedy: {even:.1f} on {control['of']}")
        )  # fmt: skip
    return found


# ---- curves --------------------------------------------------------------------------------------


def of_curves(numbers: Numbers) -> list[Claim]:
    """Of the item `curves`."""
    some = {
        id: one["curves"]
        for id, one in numbers["cmdps"].items()
        if len(one["curves"]["mbtl"]["mean"]) >= ORACLE_K
    }
    if not some:
        return []
    left = {
        id: curves["sequential_oracle"]["mean"][ORACLE_K - 1] - curves["mbtl"]["mean"][ORACLE_K - 1]
        for id, curves in some.items()
    }
    close = [id for id, value in left.items() if value <= 0.02]
    mean = float(np.mean(list(left.values())))
    far = max(left, key=lambda id: left[id])
    at = ORACLE_K - 1
    even = [c["sequential_oracle"]["mean"][at] - c["random"]["mean"][at] for c in some.values()]
    same = sum(value <= 0.02 for value in even)
    return [
        Claim(
            "Near the oracle after about 10 trainings",
            "MBTL comes close to the Sequential Oracle, which knows the whole matrix.",
            f"Reproduced: after {ORACLE_K} V is within 0.02 of the oracle's on two thirds of the "
            "CMDPs and in the mean. Partly: one of the two.",
            f"within 0.02 on {len(close)} of {len(left)}; {mean:.4f} below in the mean, at most "
            f"{left[far]:.4f} ({far})",
            verdict(
                len(close) >= 2 * len(left) / 3 and mean <= 0.02,
                len(close) >= 2 * len(left) / 3 or mean <= 0.02,
                same >= len(close),
            ),
            "03-curves",
            f"Random: on {same}; {np.mean(even):.4f} below",
        )
    ]


# ---- sensitivity ---------------------------------------------------------------------------------


def of_sensitivity(numbers: Numbers) -> list[Claim]:
    """Of the item `sensitivity`."""
    found = []
    some = numbers["algorithms"]
    rule = (
        "Reproduced: with every algorithm V of MBTL is at least that of Random and Greedy. "
        "Partly: with more than half of them."
    )
    if some:
        good = [
            name
            for name, one in some.items()
            if all(
                one["values"]["mbtl"]["mean"] >= one["values"][m]["mean"] - _TIE
                for m in _MANY
                if m in one["values"]
            )
        ]
        values = ", ".join(f"{n} {one['values']['mbtl']['mean']:.4f}" for n, one in some.items())
        full = len(good) == len(some) == 3
        lead = {name: one["mbtl_minus_random"]["value"] for name, one in some.items()}
        found.append(
            Claim("Insensitive to the RL algorithm",
                  "MBTL works with DQN, PPO and A2C alike (CartPole, pole length).", rule,
                  f"so with {len(good)} of {len(some)}; V of MBTL: {values}",
                  verdict(full, len(good) > len(some) / 2,
                          all(abs(value) <= 0.01 for value in lead.values())),
                  "08-sensitivity-algorithm",
                  "MBTL less Random (one must exceed 0.01): "
                  + ", ".join(f"{name} {value:+.4f}" for name, value in lead.items()))
        )  # fmt: skip
    rows = numbers["acquisitions"]
    if rows:
        differences = {
            row["cmdp"]: row["values"]["mbtl-ei"]["mean"] - row["values"]["mbtl"]["mean"]
            for row in rows
        }
        close = [id for id, value in differences.items() if abs(value) <= 0.01]
        mean = float(np.mean(list(differences.values())))
        gaps = [row["values"]["random"]["mean"] - row["values"]["mbtl"]["mean"] for row in rows]
        same = sum(abs(value) <= 0.01 for value in gaps)
        far = max(differences, key=lambda id: abs(differences[id]))
        found.append(
            Claim("Insensitive to the acquisition", "UCB and EI reach about the same V.",
                  "Reproduced: V differs by at most 0.01 on 90 % of the CMDPs and in the mean. "
                  "Partly: on half of them.",
                  f"within 0.01 on {len(close)} of {len(rows)}; EI less UCB {mean:+.4f} in the "
                  f"mean, farthest {differences[far]:+.4f} ({far})",
                  verdict(len(close) >= 0.9 * len(rows) and abs(mean) <= 0.01,
                          len(close) >= len(rows) / 2, same >= len(close)),
                  "08-sensitivity-acquisition",
                  f"Random instead of EI: within 0.01 on {same}")
        )  # fmt: skip
    return found


# What the paper claims in its abstract and text, and a verdict on each by a rule stated here
#
# A verdict is computed from the numbers of the items, never typed. Each claim says its rule.


__all__ = ["NOT", "NO_EVIDENCE", "OPEN", "PARTLY", "REPRODUCED", "Claim", "claims_of"]

_CLAIMS: tuple[tuple[str, Callable[[Numbers], list[Claim]]], ...] = (
    ("sample-complexity", of_efficiency),
    ("main-table", of_table),
    ("curves", of_curves),
    ("sensitivity", of_sensitivity),
    ("elimination", of_elimination),
    ("gap-correlation", of_correlation),
    ("heatmaps", of_heatmaps),
    ("multitask-rivals", of_rivals),
    ("gp-study", of_gp_study),
)


def claims_of(numbers: Mapping[str, Numbers]) -> list[Claim]:
    """The claims whose items are there, in the paper's order."""
    return [
        claim for needs, judge in _CLAIMS if needs in numbers for claim in judge(numbers[needs])
    ]
