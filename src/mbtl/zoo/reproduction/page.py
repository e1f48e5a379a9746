"""The page of the reproduction, and the list of all results: written from the numbers alone."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mbtl.errors import cannot_write
from mbtl.files import whole_file
from mbtl.report.reference import REFERENCE_NAMES
from mbtl.zoo.reproduction.bench import Bench
from mbtl.zoo.reproduction.claims import NO_EVIDENCE, NOT, OPEN, PARTLY, REPRODUCED, Claim
from mbtl.zoo.reproduction.item import Numbers, Table
from mbtl.zoo.reproduction.runner import FIGURES, TABLES, Outcome

# A verdict on each line of the paper's tables, with the reason, computed from the numbers


NEAR = 0.05
"""Difference of V at which two values count as the same level."""
LITTLE = 0.01
"""Difference of V between the oracle and Random below which there is little to choose."""

RULE = (
    "Three checks. Level: each of the six values that is there is within 0.05 of the paper's. "
    "Order: several policies (mean of Random, Greedy and MBTL) are above the better of Independent "
    "and Multi-task exactly where they are in the paper. Best: MBTL is among the best (bold in the "
    "tables) exactly where it is in the paper. Three checks: reproduced; one or two: "
    "partly; none: not."
)
_SIX = ("independent", "multitask", "random", "greedy", "mbtl", "sequential_oracle")
_SEVERAL = ("random", "greedy", "mbtl")


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
    return RowVerdict(row["cmdp"], verdict, checks, tuple(_reasons(row, checks, off)))


def _single(values: dict[str, Any]) -> float:
    return max(float(values[m]["mean"]) for m in ("independent", "multitask") if m in values)


def _several_pay(values: dict[str, Any]) -> bool:
    there = [float(values[m]["mean"]) for m in _SEVERAL if m in values]
    return sum(there) / len(there) > _single(values)


def _reasons(row: dict[str, Any], checks: dict[str, bool], off: dict[str, float]) -> Iterator[str]:
    ours, own = row["ours"], off.get("independent", 0.0)
    if own > 0:
        yield "Policies are better on their own context than the paper's, so less is left to gain"
    if own < 0:
        yield "Policies are worse on their own context than the paper's"
    if off.get("multitask", 0.0) > 0:
        yield "One policy for all contexts is a stronger baseline here"
    if not checks["order"]:
        side = "above" if _several_pay(ours) else "not above"
        yield f"Several policies are {side} the single-policy baselines, unlike in the paper"
    if not checks["best"]:
        side = "is" if "mbtl" in row["marked"] else "is not"
        yield f"MBTL {side} among the best, unlike in the paper"
    if float(ours["sequential_oracle"]["mean"]) - float(ours["random"]["mean"]) < LITTLE:
        yield f"There is little to choose: the oracle is less than {LITTLE:g} above Random"
    unguided = row["references"].get("unguided")
    if unguided and unguided["mean"] > ours["mbtl"]["mean"]:
        yield "Without a controller V is more than that of MBTL's policies"


# ---- the whole -------------------------------------------------------------------------------


COMMAND = "mbtl reproduce --page docs/reproduction.md"
_ORDER = (REPRODUCED, PARTLY, NO_EVIDENCE, NOT, OPEN)
_SHOWN = (
    ("01-main-table-aggregate", "All methods on all CMDPs together"),
    ("03-curves", "V against the number of trainings (dotted: k*)"),
    ("02-sample-complexity", "How many times fewer trainings than one per context"),
    ("05-heatmaps", "Transfer matrices: source up, target across"),
    ("09-gap-correlation", "Correlation of the gap with the distance"),
    ("11-elimination", "Search space that is left"),
)
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
    numbers = {outcome.item.name: outcome.numbers for outcome in outcomes}
    pictures = page.parent / _IMAGES
    try:
        pictures.mkdir(parents=True, exist_ok=True)
        for stem in {*(stem for stem, _ in _SHOWN), *(claim.figure for claim in claims)}:
            if (out / FIGURES / f"{stem}.png").is_file():
                shutil.copyfile(out / FIGURES / f"{stem}.png", pictures / f"{stem}.png")
    except OSError as error:
        raise cannot_write(pictures, error) from error
    parts = [
        "# The reproduction",
        f"*Written by `{COMMAND}` from the shipped transfer matrices; nothing is trained. Every "
        "number and every verdict on this page is computed, by the rules it states.*",
        *_conclusion(numbers["main-table"], claims),
        "## The claims of abstract and text",
        _claims(claims, _IMAGES),
        "## The 22 lines of the paper's tables",
        RULE,
        _rows(numbers["main-table"]),
        *[f"**{text}.**\n\n![]({_IMAGES}/{stem}.png)" for stem, text in _SHOWN
          if (pictures / f"{stem}.png").is_file()],
        "## The tables",
        *(_included(out, f"{TABLES}/01-main-table-{name}.md")
          for name in ("traffic", "control", "aggregate")),
        *(_included(out, f"{TABLES}/{name}.md")
          for name in ("02-sample-complexity", "08-sensitivity-algorithm", "10-multitask-rivals")),
        "## What is missing",
        _missing(outcomes),
        "## Made from",
        f"`{COMMAND}`. A test compares the mark of the files with those that are shipped: "
        f"`{made_from(bench)}`.",
    ]  # fmt: skip
    _write(page, "\n\n".join(part.strip() for part in parts if part) + "\n")


def made_from(bench: Bench) -> str:
    """A mark of the files of all matrices and of the transfer data; changes if they do."""
    return bench.signature(code=False)


def _conclusion(table: Numbers, claims: Sequence[Claim]) -> list[str]:
    rows = Counter(row_verdict(row).verdict for row in table["rows"])
    judged = Counter(claim.verdict for claim in claims)

    def said(counts: Counter[str]) -> str:
        return ", ".join(f"{counts[v]} {v}" for v in _ORDER if counts[v])

    there = sum(row["ours"] is not None for row in table["rows"])
    lines = [
        f"**{there} of the paper's {len(table['rows'])} CMDPs have transfer matrices here. Lines "
        f"of its tables: {said(rows)}. Claims of its text: {said(judged)}.**",
    ]
    for verdict, opening in (
        (REPRODUCED, "What holds here, too:"),
        (PARTLY, "What holds in part:"),
        (NO_EVIDENCE, "What holds, but as much for its control, so that it is no evidence:"),
        (NOT, "What does not hold here:"),
    ):
        some = [claim.title for claim in claims if claim.verdict == verdict]
        if some:
            lines.append(f"{opening} {'; '.join(some)}.")
    lines.append(
        "Recipes were chosen for how well they train and never to meet the published numbers. "
        "What differs is said below, and why, by family, in "
        "[differences.md](differences.md)."
    )
    return lines


def _claims(claims: Sequence[Claim], pictures: str) -> str:
    """A table, and the rule and the picture of each."""
    rows = tuple((c.title, c.paper, c.verdict, c.found, c.control) for c in claims)
    head = ("claim", "the paper", "verdict", "found here", "control")
    table = Table("", head, rows).markdown()
    by_rule: dict[tuple[str, str], list[str]] = {}
    for c in claims:
        by_rule.setdefault((c.rule, c.figure), []).append(c.title)
    rules = "\n".join(
        f"- *{'; '.join(titles)}.* {rule}"
        + (f" [Figure]({pictures}/{figure}.png)" if figure else "")
        for (rule, figure), titles in by_rule.items()
    )
    return (
        f"{table}\nA control lacks the cause that the claim names: selection, a model, a policy, "
        "or a dependence on the source. Where it does as well, the claim is no evidence for that "
        f"cause. The rules of these verdicts:\n\n{rules}\n"
    )


def _rows(table: Numbers) -> str:
    """A table, and below it what differs from the paper, with the lines of which it holds."""
    rows, reasons = [], dict[str, list[str]]()
    for row in table["rows"]:
        judged = row_verdict(row)
        checks = ", ".join(name for name, passed in judged.checks.items() if passed)
        values = [_short(row, name) for name in ("unguided", "nominal_policy")]
        both = (
            "" if row["ours"] is None else f"{row['ours']['mbtl']['mean']:.3f}",
            "" if row["published"] is None else f"{row['published']['mbtl']['mean']:.3f}",
        )
        rows.append((row["cmdp"], judged.verdict, checks, *both, *values))
        for reason in judged.reasons:
            reasons.setdefault(reason, []).append(row["cmdp"])
    head = ("CMDP", "verdict", "checks passed", "MBTL", "MBTL (paper)", REFERENCE_NAMES["unguided"],
            REFERENCE_NAMES["nominal_policy"])  # fmt: skip
    said = "\n".join(f"- *{reason}:* {', '.join(ids)}." for reason, ids in reasons.items())
    return f"{Table('', head, tuple(rows)).markdown()}\nWhat differs:\n\n{said}\n"


def _short(row: dict[str, object], name: str) -> str:
    references = row.get("references")
    if not isinstance(references, dict) or name not in references:
        return ""
    return f"{references[name]['mean']:.3f}"


def _missing(outcomes: Sequence[Outcome]) -> str:
    """Each thing once, with the items that lack it."""
    lacking: dict[str, list[str]] = {}
    for outcome in outcomes:
        said = outcome.missing if outcome.error is None else (f"failed: {outcome.error}",)
        for line in said:
            lacking.setdefault(line, []).append(str(outcome.item.number))
    if not lacking:
        return "Nothing."
    return "\n".join(f"- {line} (items {', '.join(n)})" for line, n in lacking.items())


def _included(out: Path, name: str) -> str:
    try:
        return (out / name).read_text(encoding="utf-8")
    except OSError:
        return ""


def _write(file: Path, text: str) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(file, error) from error
    with whole_file(file) as writing:
        writing.write((text.rstrip() + "\n").encode())
