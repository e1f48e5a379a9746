"""Parts of a page that its articles share: sections, tables, numbers."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from typing import Any


def opening(i: int, name: str, facts: str) -> list[str]:
    """The beginning of article `i`, of which only the first is shown at once."""
    return [
        f'<article data-item="{i}"{" hidden" if i else ""}>',
        f"<h1>{html.escape(name)}</h1>",
        f'<p class="facts">{html.escape(facts)}</p>',
    ]


def section(kind: str, title: str, said: str) -> str:
    """A picture with its title; scripts draw it."""
    note = f"<p>{html.escape(said)}</p>" if said else ""
    return (
        f"<section><h2>{html.escape(title)}</h2>{note}"
        f'<div class="controls" data-controls="{kind}"></div>'
        f'<div class="chart {kind}" data-chart="{kind}" role="figure" '
        f'aria-label="{html.escape(title)}"></div></section>'
    )


def details(kind: str, title: str) -> str:
    """A table that scripts fill when it is opened."""
    return (
        f'<details data-table="{kind}"><summary>{html.escape(title)}</summary>'
        '<div class="scroll"></div></details>'
    )


def number(value: float | None, digits: int = 4) -> str:
    """Rounded, never minus zero; a dash where there is none."""
    return "–" if value is None or value != value else f"{round(value, digits) + 0.0:.{digits}f}"


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Texts as a table."""
    head = "".join(f"<th scope=col>{html.escape(name)}</th>" for name in heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def provenance(record: Any) -> str:
    """How all this was made, as a record that folds out."""
    text = json.dumps(record, indent=2, default=str)
    return (
        "<section><h2>How this was made</h2><details><summary>Recipe, versions, seeds</summary>"
        f"<pre>{html.escape(text)}</pre></details></section>"
    )
