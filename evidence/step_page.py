"""What `steps.py` writes: all tables for the appendix, and the sentence and tables of the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import step_generalist as generalist
import step_tables as tables
from step_tables import ORACLE, PAPER, Plays, Sets

from mbtl.benchmark.shipped import family_of
from mbtl.benchmark.step_measure import BUDGET

FILE = Path(__file__).parents[1] / "docs/steps.md"
BEGIN, END = "<!-- begin: {} of evidence/steps.py -->", "<!-- end -->"
OURS = "pilot, mbtl"
ALONE = "one policy for all, checks free"
CHECKED = "one policy for all"
RACE = "pilot, mbtl, in turn with one policy for all"
GOAL = 10.0
SHOWN = (
    PAPER, "random, whole", "mbtl, whole", "random, 1/4", "mbtl, 1/4", "ASHA by own return",
    "ASHA from 1/16 by mean", "Hyperband by own return", "pilot, random", "pilot, spread", OURS,
    tables.CHOSEN, ALONE, CHECKED, RACE, ORACLE,
)  # fmt: skip
LADDER = {
    "no more picks than V takes": PAPER,
    "evaluation where routes hang on it": "mbtl, whole",
    "the pilot says the length": "pilot, mbtl",
}
BESIDE = ("mbtl, whole", OURS)
AGAINST = ("mbtl, whole", "pilot, spread", OURS)
PRICED = (PAPER, "mbtl, whole", OURS)


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
    lines += [*generalist.verdicts(sets, plays, OURS)]
    return lines


def conclusion(sets: Sets, plays: Plays) -> list[str]:
    """The first sentences of the page: what a rule saves, who is best, and whether it is enough."""
    here, missed = tables.cheaper(sets, plays, OURS)
    there, _ = tables.cheaper(sets, plays, OURS, papers=True)
    areas = {
        k: tables.mean_area(sets, plays, k)
        for k in plays if k not in (ORACLE, tables.CHOSEN)
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
    """The sentence and the tables of docs/steps.md."""
    some = {name: plays[name] for name in SHOWN if name in plays}
    fill("conclusion", conclusion(sets, plays))
    fill("leaderboard", tables.board(sets, some))
    fill("saving", tables.ladder(sets, plays, LADDER))
    fill("oracle", tables.against_oracle(sets, plays, AGAINST))
    fill("one policy", generalist.beside(sets, plays, BESIDE))
    fill("committee", generalist.verdicts(sets, plays, OURS))
    fill("prices", tables.prices(sets, plays, PRICED))


def fill(name: str, lines: Sequence[str]) -> None:
    """Put lines between their marks in docs/steps.md."""
    begin = BEGIN.format(name)
    head, rest = FILE.read_text(encoding="utf-8").split(begin)
    text = "\n".join([head + begin, "", *lines, "", END + rest.split(END, 1)[1]])
    FILE.write_text(text, encoding="utf-8")
