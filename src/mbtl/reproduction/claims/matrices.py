"""Claims about theory and matrices: search space, gap, heatmaps, rivals, the process itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mbtl.reproduction.claims.claim import OPEN, Claim, verdict
from mbtl.reproduction.item import Numbers


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
    return [
        Claim(
            "Search space shrinks as the corollaries assume",
            "The search space shrinks at least as fast as 1/sqrt(k), up to as fast as halving.",
            "Reproduced: in the mean over CMDPs it is at most 1/sqrt(k) at every k from 2. Partly: "
            "at half of them.",
            f"at most 1/sqrt(k) at {below} of {len(mean)} k, at most halving at {faster}; below "
            f"1/sqrt(k) at nine k of ten on {each} of {len(some)} CMDPs",
            verdict(below == len(mean), 2 * below >= len(mean)),
            "11-elimination",
        )
    ]


def of_correlation(numbers: Numbers) -> list[Claim]:
    """Of the item `gap-correlation`."""
    means = {id: one["mean"] for id, one in numbers["cmdps"].items() if one["mean"] is not None}
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
            "Reproduced: the mean over sources is so on at least two thirds of the CMDPs. Partly: "
            "on one.",
        )
        if not some:
            found.append(Claim(title, said, rule, "no matrix so far", OPEN))
            continue
        good = [id for id, r in some.items() if holds(r)]
        values = ", ".join(f"{id} {r:.2f}" for id, r in some.items())
        found.append(
            Claim(title, f"Correlation of gap and distance {said}.", rule,
                  f"so on {len(good)} of {len(some)}: {values}",
                  verdict(3 * len(good) >= 2 * len(some), bool(good)), "09-gap-correlation")
        )  # fmt: skip
    return found


Holds = Callable[[dict[str, float]], bool]


def of_heatmaps(numbers: Numbers) -> list[Claim]:
    """Of the item `heatmaps`."""
    facts = {id: one["facts"] for id, one in numbers["cmdps"].items()}
    flat = ("signal-speed", "walker-friction", "cheetah-friction")
    decay = ("cartpole-masscart", "cartpole-length", "pendulum-length")
    said: tuple[tuple[str, tuple[str, ...], str, str, str, Holds], ...] = (
        ("Heatmaps: signal inflow", ("signal-inflow",),
         "Transfer from low to high inflow is bad.",
         "low to high loses 0.1 or more and over twice of high to low",
         "low to high {up:+.3f}, high to low {down:+.3f}",
         lambda f: f["up"] <= -0.1 and f["up"] <= 2 * f["down"]),
        ("Heatmaps: near uniform", flat, "Signal speed and the frictions are near uniform.",
         "deviation between sources at most 0.05", "between sources {by_source:.3f}",
         lambda f: f["by_source"] <= 0.05),
        ("Heatmaps: green phase", ("eco-green",), "Eco-driving is better at long green.",
         "performance rises with the target's green (rank correlation above 0.5)",
         "rank correlation {target_trend:+.2f}", lambda f: f["target_trend"] > 0.5),
        ("Heatmaps: eco inflow", ("eco-inflow",), "Eco-driving is better at low inflow.",
         "performance falls with the target's inflow (rank correlation below -0.5)",
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
        rule = f"Reproduced: {rule}, on every CMDP named. Partly: on some."
        if not some:
            found.append(Claim(title, paper, rule, "no matrix so far", OPEN, "05-heatmaps"))
            continue
        good = [id for id, f in some.items() if holds(f)]
        words = "; ".join(f"{id}: {shown.format(**f)}" for id, f in some.items())
        missing = [id for id in ids if id not in some]
        words += f"; without a matrix so far: {', '.join(missing)}" if missing else ""
        found.append(
            Claim(title, paper, rule, words, verdict(len(good) == len(ids), bool(good)),
                  "05-heatmaps")
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
            "Reproduced: MOORE below on most CMDPs, PaCo level (to 0.0001) or better on one or "
            "more. Partly: one of the two.",
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
            f"error {chosen['rmse']:.4f}; the smallest is {best['rmse']:.4f} ({best['kernel']}, "
            f"noise {best['noise']:g}); the ratio is {ratio:.2f}",
            verdict(ratio <= 1.01, ratio <= 1.1),
            "13-gp-study",
        )
    ]
