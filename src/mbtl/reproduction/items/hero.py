"""The picture at the top of README: a problem where choosing clearly pays, chosen by a rule.

It is the CMDP on which MBTL is farthest ahead of the better of Random and Greedy, mean over k, of
those where V of MBTL at K is above every reference row (random actions, no controller, the nominal
policy, one random policy).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbtl.plot.style import colours, new_figure, number
from mbtl.reproduction.bench import Bench
from mbtl.reproduction.case import Case
from mbtl.reproduction.item import Item, Numbers
from mbtl.reproduction.items.policy_map import serving
from mbtl.reproduction.panels import COLOURS, DASHES
from mbtl.reproduction.paper import HEADS
from mbtl.reproduction.table import Table

_SHOWN = ("random", "greedy", "auto", "mbtl", "sequential_oracle")


def compute(bench: Bench) -> Numbers:
    """How far MBTL is ahead on each CMDP; curves and policy map of the one chosen."""
    leads: list[dict[str, Any]] = []
    for id, case in bench.cases().items():
        if "greedy" not in case.curves:
            continue
        v = case.curves["mbtl"].mean(axis=0)
        others = [case.curves[name].mean(axis=0) for name in ("random", "greedy")]
        best = max(float(row.mean()) for row in case.references.values())
        leads.append(
            {
                "cmdp": id,
                "lead": min(float((v - other).mean()) for other in others),
                "value": float(v[-1]),
                "reference": best,
            }
        )
    able = [one for one in leads if one["value"] > one["reference"]]
    if not able:
        return {"leads": leads, "chosen": None}
    chosen = max(able, key=lambda one: one["lead"])["cmdp"]
    case = bench.case(str(chosen))
    return {"leads": leads, "chosen": chosen, **_curves(case),
            "map": serving(bench, case.cmdp, case.picks["mbtl"][0])}  # fmt: skip


def _curves(case: Case) -> dict[str, Any]:
    return {
        "curves": {name: case.curves[name].mean(axis=0).tolist() for name in _SHOWN},
        "low": case.curves["mbtl"].min(axis=0).tolist(),
        "high": case.curves["mbtl"].max(axis=0).tolist(),
        "independent": float(case.levels["independent"].mean()),
        "n": case.n,
        "n_sources": case.n_sources,
        "n_seeds": case.n_seeds,
    }


def tables(numbers: Numbers) -> dict[str, Table]:
    """How each CMDP stands by the rule."""
    rows = sorted(numbers["leads"], key=lambda one: -one["lead"])
    return {
        "": Table(
            "Where choosing pays: lead of MBTL over the better of Random and Greedy, mean over k.",
            ("CMDP", "lead", "V of MBTL at K", "best reference row"),
            tuple((r["cmdp"], r["lead"], r["value"], r["reference"]) for r in rows),
            ("The picture is of the first line whose V is above its reference rows.",),
        )
    }


def figures(numbers: Numbers) -> dict[str, Any]:
    """Left: V against k. Right: which policy serves which context."""
    if numbers["chosen"] is None:
        return {}
    figure = new_figure(8.4, 3.3)
    left, right = figure.subplots(1, 2)
    for name in _SHOWN:
        curve = numbers["curves"][name]
        k = np.arange(1, len(curve) + 1)
        mine = name == "mbtl"
        label = {"mbtl": "MBTL, the paper's rule", "auto": "auto, mbtl's default"}.get(name)
        left.plot(k, curve, color=COLOURS[name], ls=DASHES.get(name, "-"), lw=2.2 if mine else 1.3,
                  label=label or HEADS[name], zorder=4 if mine else 2)  # fmt: skip
    left.axhline(numbers["independent"], color=COLOURS["independent"], ls=DASHES["independent"],
                 lw=1.3, label=f"Independent: {numbers['n_sources']} trainings")  # fmt: skip
    left.set_xlabel("trainings k")
    left.set_ylabel("generalisation performance V")
    left.xaxis.get_major_locator().set_params(integer=True)
    left.set_title(f"{numbers['chosen']}: {numbers['n']} contexts, mean of "
                   f"{numbers['n_seeds']} seeds")  # fmt: skip
    left.legend(loc="lower right", fontsize=7)
    _policies(right, numbers["map"])
    return {"": figure}


def _policies(ax: Any, found: dict[str, Any]) -> None:
    x, performance = np.array(found["x"]), np.array(found["performance"])
    last, picks = np.array(found["serving"][-1]), found["picks"]
    used = sorted(set(last.tolist()))
    palette = dict(zip(used, colours(len(used)), strict=True))
    ax.plot(x, performance, color="#999999", lw=0.7, zorder=1)
    for source in used:
        mine = last == source
        ax.plot(x[mine], performance[mine], "s", ms=4, color=palette[source], zorder=2)
    ax.set_xlabel(found["label"])
    ax.set_ylabel("performance")
    ax.set_title("Which policy serves where (numbers: MBTL's trainings)", pad=24)
    number(ax, x[picks], {i: palette.get(p, "#BBBBBB") for i, p in enumerate(picks)})


ITEM = Item(14, "hero", "README's picture: where choosing pays", compute, tables, figures)
