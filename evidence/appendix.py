"""Raw tables: each page of docs/appendix is written by one command, and by nobody's hand."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def write(name: str, title: str, reading: str, lines: Iterable[str]) -> None:
    """Write docs/appendix/`name`.md.

    Args:
        name: of the page, without its ending.
        title: its heading.
        reading: the page of docs/ that says what the tables mean, e.g. "leaderboard.md".
        lines: the tables in Markdown.
    """
    command = f"python evidence/{Path(sys.argv[0]).name} --write"
    text = "\n".join(lines).strip()
    page = f"""# {title}

`{command}` wrote this page. What the tables mean is in [{reading}](../{reading}).

{text}
"""
    (DOCS / "appendix").mkdir(exist_ok=True)
    (DOCS / "appendix" / f"{name}.md").write_text(page, encoding="utf-8")
