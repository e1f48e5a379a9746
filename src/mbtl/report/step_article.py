"""The article of a study that is paid in steps: the bill, V, the course of every training."""

from __future__ import annotations

import html
from typing import Any

from mbtl.report.parts import details, number, opening, provenance, section, table
from mbtl.study.steps.summary import counted


def step_article(i: int, item: dict[str, Any]) -> str:
    """Texts and tables, readable without scripts."""
    e = html.escape
    state = "finished" if item["finished"] else "under way"
    parts = [
        *opening(
            i,
            item["name"],
            f"strategy {item['selector']}, {item['progress']}, "
            f"{len(item['trainings'])} trainings, {item['n']} contexts, {state}",
        ),
        *(f"<p>{e(line[0].upper() + line[1:])}.</p>" for line in item["sentences"]),
        _bill(item),
    ]
    if "served" in item:
        parts.append(section("spending", "V against environment steps, all in", _V_SAID))
    if item["pieces"]:
        parts += [
            section("courses", "What the steps were paid for, one after the other", _COURSES_SAID),
            _trainings(item["trainings"]),
        ]
    if "served" in item:
        parts += [
            section("policies", "Which policy serves which context", ""),
            details("serving", "Every context: its policy, its performance, the runner-up"),
            section("heat", "Where the serving policies were evaluated", _HEAT_SAID),
        ]
        if len(item["axes"]) > 2:
            parts.append(section("pairs", "Every pair of axes, the others averaged", ""))
    parts += [_failures(item["pieces"]), provenance(item["provenance"]), "</article>"]
    return "\n".join(parts)


_V_SAID = (
    "The line is measured on the episodes that chose the policies, so it is optimistic. The dot is "
    "of fresh episodes."
)
_COURSES_SAID = (
    "A training is a line. It pauses where it has a gap and may go on later. Checks of a training "
    "on its own context are in its bars."
)
_HEAT_SAID = (
    "A policy is evaluated on few contexts first, then where routes hang on it. Where a cell is "
    "empty its return is taken to lie between those of its neighbours."
)


def _bill(item: dict[str, Any]) -> str:
    total = sum(line["steps"] for line in item["bill"])
    rows = [
        [
            line["what"],
            counted(line["steps"]),
            f"{line['steps'] / total:.0%}",
            f"{line['seconds'] / 60:.1f}" if line["seconds"] else "–",
        ]
        for line in item["bill"]
    ]
    if not rows:
        return ""
    seconds = sum(line["seconds"] for line in item["bill"])
    rows.append(["all in", counted(total), "100%", f"{seconds / 60:.1f}"])
    heads = ["paid for", "environment steps", "share", "minutes"]
    return f"<section><h2>The bill</h2>{table(heads, rows)}</section>"


def _trainings(trainings: list[dict[str, Any]]) -> str:
    rows = [
        [
            str(one["number"] + 1),
            one["trained_on"],
            counted(one["steps"]),
            number(one["steps"] / one["whole"], 2),
            str(one["policies"]),
            str(one["serves"]),
            f"{one['seconds'] / 60:.1f}",
            f"{one['state']}: {one['why']}",
        ]
        for one in trainings
    ]
    heads = [
        "training", "trained on", "steps", "of a whole one", "policies evaluated",
        "contexts served", "minutes", "state, and why",
    ]  # fmt: skip
    return f"<section><h2>How far each training went, and why</h2>{table(heads, rows)}</section>"


def _failures(done: list[dict[str, Any]]) -> str:
    failed = [piece for piece in done if piece["kind"] == "failed"]
    body = ""
    for piece in failed:
        trace = html.escape(piece["traceback"] or "no traceback was recorded")
        body += (
            f"<details><summary>{html.escape(piece['said'])}</summary><pre>{trace}</pre></details>"
        )
    return f"<section><h2>Failures</h2>{body}</section>" if body else ""
