"""What commands write into docs: whole pages of docs/appendix, and tables between two marks."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def fill(page: str, name: str, lines: Sequence[str]) -> None:
    """Put lines between their marks, which name the command, into a page of docs/."""
    begin, end = f"<!-- begin: {name} of evidence/{_script()} -->", "<!-- end -->"
    head, rest = (DOCS / page).read_text(encoding="utf-8").split(begin)
    text = "\n".join([head + begin, "", *lines, "", end + rest.split(end, 1)[1]])
    (DOCS / page).write_text(text, encoding="utf-8")


def write_appendix(name: str, title: str, reading: str, lines: Iterable[str]) -> None:
    """Write docs/appendix/`name`.md.

    Args:
        name: of the page, without its ending.
        title: its heading.
        reading: the page of docs/ that says what the tables mean, e.g. "leaderboard.md".
        lines: the tables in Markdown.
    """
    command = f"python evidence/{_script()} --write"
    text = "\n".join(lines).strip()
    page = f"""# {title}

`{command}` wrote this page. What the tables mean is in [{reading}](../{reading}).

{text}
"""
    (DOCS / "appendix").mkdir(exist_ok=True)
    (DOCS / "appendix" / f"{name}.md").write_text(page, encoding="utf-8")


def _script() -> str:
    return Path(sys.argv[0]).name
