"""What `steps.py` writes: all tables for the appendix, and the sentence and tables of the page."""

from __future__ import annotations

from pathlib import Path

import step_generalist as generalist
import step_tables as tables
from step_tables import ORACLE, PAPER, Plays, Sets

from mbtl.benchmark.shipped import family_of
from mbtl.benchmark.step_measure import BUDGET

FILE = Path(__file__).parents[1] / "docs/steps.md"
BEGIN, END = "<!-- begin: evidence/steps.py --write, {} -->", "<!-- end -->"
OURS = "pilot, spread"
GOAL = 10.0
SHOWN = (
    PAPER, "random, whole", "mbtl, whole", "random, 1/4", "mbtl, 1/4", "ASHA by own return",
    "Hyperband by own return", "pilot, random", OURS, "pilot, mbtl", ORACLE,
)  # fmt: skip
LADDER = ("mbtl, whole", "spread, whole", OURS)
BESIDE = ("mbtl, whole", OURS)


def everything(sets: Sets, plays: Plays) -> list[str]:
    """All tables."""
    families = sorted({family_of(name) for name in sets})
    some = [name for name in SHOWN if name in plays]
    lines = [f"{_sets(sets)}, {BUDGET:.0f} units", "", *tables.board(sets, plays)]
    for family in families:
        one = {name: seeds for name, seeds in sets.items() if family_of(name) == family}
        lines += ["", f"## {family} alone", "", *tables.board(one, plays)]
    lines += ["", "## Set by set", ""]
    for what in ("times cheaper, prices here / paper's", "area"):
        lines += [*tables.each(sets, plays, some, what), ""]
    lines += [*tables.against_oracle(sets, plays, some[:-1]), ""]
    lines += [*tables.ladder(sets, plays, LADDER), ""]
    lines += [*tables.prices(sets, plays, some), ""]
    lines += ["## One policy for all", "", *generalist.beside(sets, plays, some), ""]
    lines += [*generalist.committee(sets, plays, OURS), "", "## Constants", ""]
    return lines


def conclusion(sets: Sets, plays: Plays) -> list[str]:
    """The first sentences of the page: what a rule saves, who is best, and whether it is enough."""
    here, missed = tables.cheaper(sets, plays, OURS)
    there, _ = tables.cheaper(sets, plays, OURS, papers=True)
    areas = {
        k: tables.evenly(sets, lambda n, s, k=k: tables.area(sets, plays, k, n)[s])
        for k in plays if k != ORACLE
    }  # fmt: skip
    best = max(areas, key=lambda k: areas[k])
    above = tables.not_behind(sets, plays, OURS)
    least = "at most " if missed else ""
    reached = "reached" if here >= GOAL and not missed else "not reached"
    lead = (
        f"No other strategy has a larger area ({areas[OURS]:.3f})."
        if best == OURS
        else f"The largest area has `{best}`: {areas[best]:.3f} against {areas[OURS]:.3f}."
    )
    verdict = "at least" if 2 * above >= len(sets) else "fewer than"
    return [
        f"**With a pilot, V of fifteen whole trainings of the paper's MBTL costs {least}{here:.1f} "
        f"times fewer environment steps at the prices charged here, and {there:.0f} times fewer "
        f"than by the paper's protocol** ({_sets(sets)}, families alike). A tenth of the steps at "
        f"equal prices was the goal: {reached}. It is not behind the Sequential Oracle of whole "
        f"trainings at equal steps on {above} of {len(sets)} sets, {verdict} half. {lead}"
    ]


def _sets(sets: Sets) -> str:
    families = sorted({family_of(name) for name in sets})
    return f"{len(sets)} sets of {len(families)} families ({', '.join(families)}), three seeds each"


def write(sets: Sets, plays: Plays) -> None:
    """Put them between their marks in docs/steps.md."""
    some = {name: plays[name] for name in SHOWN if name in plays}
    parts = {
        "conclusion": conclusion(sets, plays),
        "leaderboard": tables.board(sets, some),
        "saving": tables.ladder(sets, plays, LADDER),
        "oracle": tables.against_oracle(sets, plays, ("mbtl, whole", OURS, "pilot, mbtl")),
        "one policy": generalist.beside(sets, plays, BESIDE),
        "committee": generalist.committee(sets, plays, OURS),
        "prices": tables.prices(sets, plays, (PAPER, "mbtl, whole", OURS)),
    }
    text = FILE.read_text(encoding="utf-8")
    for name, lines in parts.items():
        begin = BEGIN.format(name)
        head, rest = text.split(begin)
        tail = rest.split(END, 1)[1]
        text = "\n".join([head + begin, "", *lines, "", END + tail])
    FILE.write_text(text, encoding="utf-8")
