"""Tables as CSV, Markdown and LaTeX, from the same cells."""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import dataclass
from typing import Literal

from mbtl.reproduction.paper import Value


@dataclass(frozen=True)
class Measured:
    """A mean with its deviation over seeds; bold if it is marked as the best."""

    mean: float
    std: float | None = None
    marked: bool = False
    digits: int = 4

    @classmethod
    def of(cls, value: Value | None, marked: bool = False) -> Measured | None:
        """Of a value that may be missing."""
        return None if value is None else cls(value.mean, value.std, marked)


Cell = Measured | float | int | str | None
"""None stands for what is not there."""

_FORMATS = ("csv", "md", "tex")
_DIGITS = 4
_LATEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#",
    "%": r"\%", "_": r"\_", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}",
    "<": r"\textless{}", ">": r"\textgreater{}",
}  # fmt: skip


@dataclass(frozen=True)
class Table:
    """Cells with a head, a caption and notes below.

    Attributes:
        caption: what it shows, a sentence.
        head: names of the columns.
        rows: cells; each row as long as `head`.
        notes: what must be said beside it.
    """

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()

    def write(self, form: Literal["csv", "md", "tex"]) -> str:
        """The table in a format."""
        return {"csv": self.csv, "md": self.markdown, "tex": self.latex}[form]()

    def csv(self) -> str:
        """Full precision; a measured column becomes three: mean, standard deviation, marked."""
        measured = [
            any(isinstance(row[i], Measured) for row in self.rows) for i in range(len(self.head))
        ]
        head: list[str] = []
        for name, three in zip(self.head, measured, strict=True):
            head += [f"{name} mean", f"{name} std", f"{name} marked"] if three else [name]
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(head)
        for row in self.rows:
            cells: list[object] = []
            for cell, three in zip(row, measured, strict=True):
                if isinstance(cell, Measured):
                    cells += [cell.mean, "" if cell.std is None else cell.std, int(cell.marked)]
                elif three:
                    cells += ["" if cell is None else cell, "", ""]
                else:
                    cells.append("" if cell is None else cell)
            writer.writerow(cells)
        return out.getvalue()

    def markdown(self) -> str:
        """For GitHub and Sphinx."""
        lines = [f"{_markdown_text(self.caption)}", ""]
        lines.append("| " + " | ".join(_markdown_text(name) for name in self.head) + " |")
        numbers = [self._is_number(i) for i in range(len(self.head))]
        lines.append("|" + "|".join("---:" if right else "---" for right in numbers) + "|")
        lines += ["| " + " | ".join(_markdown(cell) for cell in row) + " |" for row in self.rows]
        lines += [line for note in self.notes for line in ("", _markdown_text(note))]
        return "\n".join(lines) + "\n"

    def latex(self) -> str:
        """A `table` for a document that loads booktabs."""
        columns = "".join("r" if self._is_number(i) else "l" for i in range(len(self.head)))
        caption = " ".join([self.caption, *self.notes])
        lines = [
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{escape_latex(caption)}}}",
            rf"\begin{{tabular}}{{{columns}}}",
            r"\toprule",
            " & ".join(escape_latex(name) for name in self.head) + r" \\",
            r"\midrule",
        ]
        lines += [" & ".join(_latex(cell) for cell in row) + r" \\" for row in self.rows]
        lines += [r"\bottomrule", r"\end{tabular}", r"\end{table}"]
        return "\n".join(lines) + "\n"

    def _is_number(self, column: int) -> bool:
        return all(not isinstance(row[column], str) or row[column] == "" for row in self.rows)


def escape_latex(text: str) -> str:
    """Plain text for LaTeX."""
    return re.sub(r"[\\{}$&#%_^~<>]", lambda found: _LATEX[found[0]], text)


def _markdown_text(text: str) -> str:
    return re.sub(r"([|*_`<\[\]])", r"\\\1", text).replace("\n", " ")


def _number(value: float, digits: int = _DIGITS) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value:.{digits}f}"


def _plain(cell: Cell) -> str:
    if cell is None:
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, float):
        return _number(cell)
    return str(cell)


def _markdown(cell: Cell) -> str:
    if isinstance(cell, Measured):
        mean = _number(cell.mean, cell.digits)
        mean = f"**{mean}**" if cell.marked else mean
        return mean if cell.std is None else f"{mean} ± {_number(cell.std, cell.digits)}"
    return _markdown_text(_plain(cell))


def _latex(cell: Cell) -> str:
    if isinstance(cell, Measured):
        mean = _number(cell.mean, cell.digits)
        mean = rf"\mathbf{{{mean}}}" if cell.marked else mean
        return (
            f"${mean}$" if cell.std is None else rf"${mean} \pm {_number(cell.std, cell.digits)}$"
        )
    if isinstance(cell, (int, float)) and not isinstance(cell, bool):
        return f"${_plain(cell)}$" if _plain(cell) != "-" else "-"
    return escape_latex(_plain(cell))


FORMATS = _FORMATS
"""What `Table.write` knows."""
