"""Tables as notebooks show them: plain HTML, whatever a study or a stranger's file has in it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

MOST = 60
"""Lines shown of a long table: the first and the last ones."""


def table(title: str, heads: Sequence[str], lines: Iterable[Sequence[Any]]) -> str:
    """A captioned table; None is an empty cell, real numbers have four digits."""
    shown = [[_text(cell) for cell in line] for line in lines]
    if len(shown) > MOST:
        shown[MOST // 2 : -MOST // 2] = [["..."] * len(heads)]
    rows = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in line)}</tr>" for line in shown)
    top = "".join(f"<th>{escape(head)}</th>" for head in heads)
    return (
        f"<table><caption>{escape(title)}</caption><thead><tr>{top}</tr></thead>"
        f"<tbody>{rows}</tbody></table>"
    )


def _text(cell: Any) -> str:
    if cell is None:
        return ""
    return escape(f"{cell:.4g}" if isinstance(cell, float) else str(cell))
