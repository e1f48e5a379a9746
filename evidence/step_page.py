"""What `steps.py` writes: all tables for the appendix, and the sentence and tables of the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pages
import step_generalist as generalist
import step_tables as tables
from step_measure import BUDGET
from step_tables import ORACLE, PAPER, Plays, Sets

from mbtl.zoo.benchmark.shipped import family_of

OURS = "mbtl, whole, evaluation a tenth"
PILOT = "pilot, mbtl"
FIVE = "mbtl, whole"
COMMITTEE = "committee"
ALONE = "one policy for all"
RACE = "mbtl, evaluation a tenth, in turn with one policy for all"
GOAL = 10.0
EARLY = 2.0
"""Units: steps for one or two whole trainings."""
SHOWN = (
    PAPER, "random, whole", "spread, whole", FIVE, OURS, "mbtl, 1/2", "random, 1/4", "mbtl, 1/4",
    "ASHA by own return", "ASHA from 1/16 by mean", "Hyperband by own return", "pilot, random",
    "pilot, spread", PILOT, COMMITTEE,
    "auto, whole, evaluation a tenth", "pilot, auto", tables.CHOSEN, ALONE, RACE, ORACLE,
)  # fmt: skip
LADDER = {
    "no more picks than V takes": PAPER,
    "evaluation for a tenth of the training, then where routes hang on it": OURS,
    "evaluation on five contexts, then where routes hang on it": FIVE,
    "a pilot says the length": PILOT,
}
ALONG = (PAPER, FIVE, OURS, "mbtl, 1/4", PILOT, ALONE, ORACLE)
BESIDE = (PAPER, FIVE, OURS, PILOT)
PRICED = (PAPER, OURS, PILOT)


Said = Mapping[str, list[generalist.Decided]]


def verdicts(sets: Sets, plays: Plays, said: Said) -> list[str]:
    """What the committee says of each set."""
    return generalist.verdicts(sets, plays, said, COMMITTEE, PILOT)


def everything(sets: Sets, plays: Plays, found: Sequence[str]) -> list[str]:
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
    lines += [*tables.along(sets, plays, some), ""]
    lines += [*tables.against_oracle(sets, plays, some[:-1]), ""]
    lines += [*tables.ladder(sets, plays, LADDER), ""]
    lines += [*tables.prices(sets, plays, some), ""]
    lines += ["## One policy for all", "", *generalist.beside(sets, plays, some), ""]
    lines += found
    return lines


def conclusion(sets: Sets, plays: Plays) -> list[str]:
    """The first sentences of the page: what is saved and by what, and who is better."""
    here, missed = tables.cheaper(sets, plays, OURS)
    there, _ = tables.cheaper(sets, plays, OURS, papers=True)
    each = []
    for family in sorted({family_of(name) for name in sets}):
        one = {n: seeds for n, seeds in sets.items() if family_of(n) == family}
        times, some_missed = tables.cheaper(one, plays, OURS)
        each.append(f"{family} {'at most ' if some_missed else ''}{times:.1f}")
    reached = "reached" if here >= GOAL and not missed else "not reached"
    papers = "reached" if there >= GOAL else "not reached"
    above = tables.not_behind(sets, plays, OURS)
    patience, _ = tables.cheaper(sets, plays, PAPER)
    slower, late = tables.cheaper(sets, plays, PILOT)
    first, last = (
        [name for name in sets if generalist.ahead(sets, plays, OURS, name, units)]
        for units in (EARLY, BUDGET)
    )
    areas = {
        k: tables.mean_area(sets, plays, k)
        for k in plays if k not in (ORACLE, tables.CHOSEN, RACE)
    }  # fmt: skip
    best = max(areas, key=lambda k: areas[k])
    return [
        f"**Train to the end, and spend a tenth of its steps on evaluation: V of fifteen trainings "
        f"of the paper's MBTL then costs {'at most ' if missed else ''}{here:.1f} times fewer "
        f"environment steps, all in ({', '.join(each)}), and {there:.0f} times fewer than by the "
        f"paper's protocol. A rival wins in places: one policy for all contexts, shown the context "
        f"in CartPole and Pendulum, is ahead at equal steps within {EARLY:g} units (of a whole "
        f"training and its evaluation) on {_names(first)}, and within {BUDGET:.0f} on "
        f"{_names(last)}. The committee tries both, and says where one is enough "
        "([how often it is right](#the-committee-finds-out-by-itself-whether-one-policy-is-enough))"
        ".**",
        "",
        f"A factor of {patience:.1f} of that saving is had by not picking on when V is there. Ten "
        f"times fewer was the goal: at equal prices it is {reached}, at the paper's {papers}. V is "
        f"not behind the Sequential Oracle's at equal steps on {above} of {len(sets)} sets. "
        f"Shorter trainings bring V earlier, and not higher: with a pilot that says the length the "
        f"area is {areas[PILOT]:.3f} instead of {areas[OURS]:.3f}, and the factor "
        f"{'at most ' if late else ''}{slower:.1f} instead of {here:.1f}. The largest area has "
        f"`{best}`, {areas[best]:.3f}.",
        "",
        f"All figures: {_sets(sets)}; families count alike.",
    ]


def _names(sets: Sequence[str]) -> str:
    return ", ".join(sets) or "no set"


def _sets(sets: Sets) -> str:
    families = sorted({family_of(name) for name in sets})
    return f"{len(sets)} sets of {len(families)} families ({', '.join(families)}), three seeds each"


def write(sets: Sets, plays: Plays, found: Sequence[str]) -> None:
    """The sentence and the tables of docs/steps.md."""
    some = {name: plays[name] for name in SHOWN if name in plays}
    fill("conclusion", conclusion(sets, plays))
    fill("leaderboard", tables.board(sets, some))
    fill("lengths", tables.along(sets, plays, ALONG))
    fill("saving", tables.ladder(sets, plays, LADDER))
    fill("oracle", tables.against_oracle(sets, plays, BESIDE))
    fill("one policy", generalist.beside(sets, plays, BESIDE))
    fill("committee", found)
    fill("prices", tables.prices(sets, plays, PRICED))


def fill(name: str, lines: Sequence[str]) -> None:
    """Put lines between their marks in docs/steps.md."""
    pages.fill("steps.md", name, lines)
