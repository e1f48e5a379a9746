"""The page of the reproduction, and the list of all results: written from the numbers alone."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mbtl.errors import written
from mbtl.files import whole_file
from mbtl.report.reference import REFERENCE_NAMES
from mbtl.zoo.reproduction.bench import Bench
from mbtl.zoo.reproduction.claims import NO_EVIDENCE, NOT, OPEN, PARTLY, REPRODUCED, Claim
from mbtl.zoo.reproduction.item import Table
from mbtl.zoo.reproduction.items.main_table import DOMAINS, MARKS
from mbtl.zoo.reproduction.runner import FIGURES, Outcome

# A verdict on each line of the paper's tables, with the reason, computed from the numbers


NEAR = 0.05
"""Difference of V at which two values count as the same level."""
LITTLE = 0.01
"""Difference of V between the oracle and Random below which there is little to choose."""

RULE = (
    "Each line has three checks. *Level*: all values are within 0.05 of the paper's. *Order*: "
    "several policies (the mean of Random, Greedy and MBTL) are above the better of Independent "
    "and Multi-task exactly where they are in the paper. *Best*: MBTL is among the best (bold in "
    "the tables below) exactly where it is in the paper. All three passed: reproduced; one or two: "
    "partly; none: not."
)
_SIX = ("independent", "multitask", "random", "greedy", "mbtl", "sequential_oracle")
_SEVERAL = ("random", "greedy", "mbtl")
_REFERENCES = ("unguided", "nominal_policy")


@dataclass(frozen=True)
class RowVerdict:
    """One CMDP.

    Attributes:
        cmdp: its id.
        verdict: as in `mbtl.zoo.reproduction.claims`.
        checks: name -> passed; empty where there is no matrix.
        reasons: what differs from the paper, each in words that other lines have, too.
    """

    cmdp: str
    verdict: str
    checks: dict[str, bool]
    reasons: tuple[str, ...]


def row_verdict(row: dict[str, Any]) -> RowVerdict:
    """The verdict on a line of item 1's numbers."""
    ours, paper = row["ours"], row["published"]
    if ours is None or paper is None:
        reason = "No matrix yet" if ours is None else "Not in the paper"
        return RowVerdict(row["cmdp"], OPEN, {}, (reason,))
    away = {m: ours[m]["mean"] - paper[m]["mean"] for m in _SIX if m in ours}
    off = {m: d for m, d in away.items() if abs(d) > NEAR}
    checks = {
        "level": not off,
        "order": _several_pay(ours) == _several_pay(paper),
        "best": ("mbtl" in row["marked"]) == ("mbtl" in row["published_marked"]),
    }
    passed = sum(checks.values())
    verdict = REPRODUCED if passed == len(checks) else PARTLY if passed else NOT
    return RowVerdict(row["cmdp"], verdict, checks, tuple(_reasons(row, off)))


def _single(values: dict[str, Any]) -> float:
    return max(float(values[m]["mean"]) for m in ("independent", "multitask") if m in values)


def _several_pay(values: dict[str, Any]) -> bool:
    there = [float(values[m]["mean"]) for m in _SEVERAL if m in values]
    return sum(there) / len(there) > _single(values)


def _reasons(row: dict[str, Any], off: dict[str, float]) -> Iterator[str]:
    """What the checks do not say."""
    ours, own = row["ours"], off.get("independent", 0.0)
    if own > 0:
        yield "Policies are better on their own context than the paper's, so less is left to gain"
    if own < 0:
        yield "Policies are worse on their own context than the paper's"
    if off.get("multitask", 0.0) > 0:
        yield "One policy for all contexts is a stronger baseline here"
    if float(ours["sequential_oracle"]["mean"]) - float(ours["random"]["mean"]) < LITTLE:
        yield f"There is little to choose: the oracle is less than {LITTLE:g} above Random"
    unguided = row["references"].get("unguided")
    if unguided and unguided["mean"] > ours["mbtl"]["mean"]:
        yield "Without a controller V is more than that of MBTL's policies"


# ---- the whole -------------------------------------------------------------------------------


COMMAND = "mbtl reproduce --page docs/reproduction.md"
_ORDER = (REPRODUCED, PARTLY, NO_EVIDENCE, NOT, OPEN)
_TITLES = {
    REPRODUCED: "Reproduced",
    PARTLY: "Reproduced in part",
    NO_EVIDENCE: "No evidence: the control does as well",
    NOT: "Not reproduced",
    OPEN: "Not testable",
}
_SHOWN = (
    ("01-main-table-aggregate", "All methods on all CMDPs together"),
    ("03-curves", "V against the number of trainings (dotted: k*)"),
    ("02-sample-complexity", "How many times fewer trainings than one per context"),
    ("05-heatmaps", "Transfer matrices: source up, target across"),
    ("09-gap-correlation", "Correlation of the gap with the distance"),
    ("11-elimination", "Search space that is left"),
)
_LEFT_OUT = {
    "main-table": ("Oracle Transfer", "interquartile mean of V", MARKS),
    "sensitivity": ("Oracle Transfer",),
    "sample-complexity": ("mean level", "set by", "mean", "mean (paper)"),
}
"""Columns and notes of the files of the results that would say little more here."""
_IMAGES = "images/reproduction"


def write_index(file: Path, outcomes: Sequence[Outcome], claims: Sequence[Claim]) -> None:
    """What is in a folder of results, what is not and why."""
    lines = ["# Reproduction: what is here", "", "Written by `mbtl reproduce`.", ""]
    for outcome in outcomes:
        lines += [f"## {outcome.item.number}. {outcome.item.title}", ""]
        if outcome.error is not None:
            lines += [f"Failed: {outcome.error} ({outcome.files[0]} has the traceback).", ""]
            continue
        lines += [f"- [{name}]({name})" for name in outcome.files]
        lines += [f"- not available: {said}" for said in outcome.missing]
        lines.append("")
    if claims:
        lines += ["## Claims of the paper", "", _claims(claims, FIGURES)]
    _write(file, "\n".join(lines))


def write_page(
    page: Path, bench: Bench, outcomes: Sequence[Outcome], claims: Sequence[Claim], out: Path
) -> None:
    """Write docs/reproduction.md, and its pictures beside it.

    Args:
        page: file to write.
        bench: what was looked at; its files are named at the end of the page.
        outcomes: of all items.
        claims: judged on them.
        out: folder of the results, with the pictures.
    """
    items = {outcome.item.name: outcome for outcome in outcomes}
    rows = items["main-table"].numbers["rows"]
    pictures = page.parent / _IMAGES
    with written(pictures):
        pictures.mkdir(parents=True, exist_ok=True)
        for stem in {*(stem for stem, _ in _SHOWN), *(claim.figure for claim in claims)}:
            if (out / FIGURES / f"{stem}.png").is_file():
                shutil.copyfile(out / FIGURES / f"{stem}.png", pictures / f"{stem}.png")
    parts = [
        "# The reproduction",
        *_conclusion(rows, claims),
        "## The claims of abstract and text",
        _claims(claims, _IMAGES),
        f"## The {len(rows)} lines of the paper's tables",
        RULE,
        *(_verdicts([row for row in rows if row["domain"] == domain]) for domain in DOMAINS),
        _differences(rows),
        "## Figures",
        *[f"**{text}.**\n\n![]({_IMAGES}/{stem}.png)" for stem, text in _SHOWN
          if (pictures / f"{stem}.png").is_file()],
        "## Appendix: all values",
        MARKS,
        *_tables(items["main-table"], *DOMAINS, "aggregate"),
        *_tables(items["sample-complexity"], ""),
        *_tables(items["sensitivity"], "algorithm"),
        *_tables(items["multitask-rivals"], ""),
        _missing(outcomes),
        f"*Written by `{COMMAND}`. A test compares the mark of the files with those that are "
        f"shipped: `{made_from(bench)}`.*",
    ]  # fmt: skip
    _write(page, "\n\n".join(part.strip() for part in parts if part) + "\n")


def made_from(bench: Bench) -> str:
    """A mark of the files of all matrices and of the transfer data; changes if they do."""
    return bench.signature(code=False)


def _conclusion(rows: Sequence[dict[str, Any]], claims: Sequence[Claim]) -> list[str]:
    lines = Counter(row_verdict(row).verdict for row in rows)
    judged = Counter(claim.verdict for claim in claims)

    def said(counts: Counter[str]) -> str:
        return ", ".join(f"{counts[v]} {v}" for v in _ORDER if counts[v])

    there = sum(row["ours"] is not None for row in rows)
    return [
        f"**Lines of the paper's tables: {said(lines)}. Claims of its text: {said(judged)}.** "
        f"All is computed from the transfer matrices of {there} CMDPs; nothing is trained. Recipes "
        "were chosen for how well they train, never to meet the published numbers; "
        "[why values differ](differences.md).",
        "V is the mean performance over contexts, each served by the best of the policies so far. "
        "K = 15 trainings are made, of M possible sources; *k\\** counts them until V is as good "
        "as the better of one policy per context (*Independent*) and one for all (*Multi-task*). "
        "Other words: [concepts](concepts.md); the rules that choose: [selectors](leaderboard.md).",
    ]


def _claims(claims: Sequence[Claim], pictures: str) -> str:
    """A table per verdict, and the rule and the picture of each."""
    parts = [
        "A *control* lacks the cause that the claim names: selection, a model, a policy, or a "
        "dependence on the source. Where it does as well, the claim is no evidence."
    ]
    for verdict in _ORDER:
        rows = tuple((c.title, c.paper, c.found, c.control) for c in claims if c.verdict == verdict)
        if rows:
            table = Table("", ("claim", "the paper", "here", "control"), rows).markdown()
            parts += [f"### {_TITLES[verdict]}", table]
    by_rule: dict[tuple[str, str], list[str]] = {}
    for c in claims:
        by_rule.setdefault((c.rule, c.figure), []).append(c.title)
    rules = "\n".join(
        f"- *{'; '.join(titles)}:* {rule}"
        + (f" [Figure]({pictures}/{figure}.png)" if figure else "")
        for (rule, figure), titles in by_rule.items()
    )
    return "\n\n".join(part.strip() for part in (*parts, "### The rules", rules)) + "\n"


def _verdicts(rows: Sequence[dict[str, Any]]) -> str:
    """A table of lines, each beside what there is without selection."""
    shown = []
    for row in rows:
        judged = row_verdict(row)
        checks = ", ".join(name for name, passed in judged.checks.items() if passed)
        ours = "" if row["ours"] is None else f"{row['ours']['mbtl']['mean']:.3f}"
        known = row.get("references") or {}
        values = (f"{known[n]['mean']:.3f}" if n in known else "" for n in _REFERENCES)
        shown.append((row["cmdp"], judged.verdict, checks, ours, *values))
    head = ("CMDP", "verdict", "checks passed", "MBTL", *(REFERENCE_NAMES[n] for n in _REFERENCES))
    return Table("", head, tuple(shown)).markdown()


def _differences(rows: Sequence[dict[str, Any]]) -> str:
    """What differs from the paper, with the lines of which it holds."""
    reasons: dict[str, list[str]] = {}
    for row in rows:
        for reason in row_verdict(row).reasons:
            reasons.setdefault(reason, []).append(row["cmdp"])
    said = "\n".join(f"- *{reason}:* {', '.join(ids)}." for reason, ids in reasons.items())
    return f"What differs:\n\n{said}"


def _tables(outcome: Outcome, *names: str) -> Iterator[str]:
    """Those of an item that are worth a place on the page."""
    if outcome.numbers:
        found = outcome.item.tables(outcome.numbers)
        for name in names:
            if name in found:
                yield found[name].without(_LEFT_OUT.get(outcome.item.name, ())).markdown()


def _missing(outcomes: Sequence[Outcome]) -> str:
    """Each thing once, with the items that lack it."""
    lacking: dict[str, list[str]] = {}
    for outcome in outcomes:
        said = outcome.missing if outcome.error is None else (f"failed: {outcome.error}",)
        for line in said:
            lacking.setdefault(line, []).append(str(outcome.item.number))
    lines = [f"- {line} (items {', '.join(n)})" for line, n in lacking.items()]
    return "\n".join(["## What is missing", "", *lines]) if lines else ""


def _write(file: Path, text: str) -> None:
    with written(file):
        file.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(file) as writing:
        writing.write((text.rstrip() + "\n").encode())
