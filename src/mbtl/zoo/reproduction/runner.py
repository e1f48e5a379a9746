"""Runs items one after another: finished ones are kept, and one that fails stops no other."""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from mbtl.errors import MbtlError, unknown_name
from mbtl.files import whole_file
from mbtl.plot.style import save, style
from mbtl.zoo.reproduction.bench import Bench, read_record, write_record
from mbtl.zoo.reproduction.item import Item, Numbers
from mbtl.zoo.reproduction.items import (
    curves,
    elimination,
    gap_correlation,
    gp_study,
    heatmaps,
    main_table,
    multitask_rivals,
    sample_complexity,
    sensitivity,
)

# ---- the items by number: the paper's experiments in its order -------------------------------


ITEMS: tuple[Item, ...] = (
    main_table.ITEM,
    sample_complexity.ITEM,
    curves.ITEM,
    heatmaps.ITEM,
    sensitivity.ITEM,
    gap_correlation.ITEM,
    multitask_rivals.ITEM,
    elimination.ITEM,
    gp_study.ITEM,
)


def items_named(names: Sequence[str]) -> list[Item]:
    """Items by number or name, in order; all without any.

    Raises:
        UnknownName: there is no such item.
    """
    if not names:
        return list(ITEMS)
    by_name = {**{str(item.number): item for item in ITEMS}, **{item.name: item for item in ITEMS}}
    for name in names:
        if name not in by_name:
            known = [f"{item.number} ({item.name})" for item in ITEMS]
            raise unknown_name(
                "item", name, [item.name for item in ITEMS], hint=f"Known: {', '.join(known)}."
            )
    wanted = {by_name[name].number for name in names}
    return [item for item in ITEMS if item.number in wanted]


# ---- the whole -------------------------------------------------------------------------------


NUMBERS, TABLES, FIGURES = "numbers", "tables", "figures"
"""Folders of the output."""

Status = Literal["done", "kept", "failed"]


@dataclass(frozen=True)
class Outcome:
    """What became of an item.

    Attributes:
        item: which.
        status: made now, kept from before, or failed.
        seconds: processor time.
        files: written, relative to the output folder.
        missing: what it could not have and why.
        error: of one that failed.
        numbers: its numbers, unless it failed.
    """

    item: Item
    status: Status
    seconds: float
    files: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    error: str | None = None
    numbers: Numbers = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return {
            "item": self.item.number,
            "name": self.item.name,
            "title": self.item.title,
            "status": self.status,
            "seconds": round(self.seconds, 2),
            "files": list(self.files),
            "missing": list(self.missing),
            "error": self.error,
        }


def perform(
    items: Sequence[Item],
    bench: Bench,
    out: Path,
    on_item: Callable[[Item, Outcome | None], None] = lambda item, outcome: None,
    *,
    again: bool = False,
) -> list[Outcome]:
    """Make what is missing or made of other inputs.

    Args:
        items: in this order.
        bench: what they look at.
        out: folder of the results.
        on_item: called before each item with None, and after it with its outcome.
        again: make all of them.
    """
    found = []
    for item in items:
        on_item(item, None)
        found.append(_one(item, bench, out, again))
        on_item(item, found[-1])
    return found


def _one(item: Item, bench: Bench, out: Path, again: bool) -> Outcome:
    begin = time.process_time()
    trace = out / f"{item.stem}.error.txt"
    try:
        made_of = bench.signature(item.prefixes, item.variants)
        file = out / NUMBERS / f"{item.stem}.json"
        record = None if again else read_record(file)
        if record and record.get("made_of") == made_of and _all_there(out, record["files"]):
            numbers, files = record["numbers"], record["files"]
            status: Status = "kept"
        else:
            # as they are kept: what is drawn now is what would be drawn from the file
            numbers, status = json.loads(json.dumps(item.compute(bench))), "done"
            files = [f"{NUMBERS}/{file.name}", *_written(item, numbers, out)]
            write_record(file, {"made_of": made_of, "files": files, "numbers": numbers})
        trace.unlink(missing_ok=True)
    except Exception as error:  # whatever it is, the other items can be had
        trace.parent.mkdir(parents=True, exist_ok=True)
        trace.write_text(traceback.format_exc(), encoding="utf-8")
        said = str(error) if isinstance(error, MbtlError) else f"{type(error).__name__}: {error}"
        return Outcome(item, "failed", time.process_time() - begin, (trace.name,), error=said)
    seconds = time.process_time() - begin
    missing = tuple(numbers.get("missing", ()))
    return Outcome(item, status, seconds, tuple(files), missing, numbers=numbers)


def _all_there(out: Path, files: Sequence[str]) -> bool:
    return all((out / name).is_file() for name in files)


def _written(item: Item, numbers: Numbers, out: Path) -> list[str]:
    """Tables and figures of an item, drawn from its numbers."""
    files = []
    for name, table in item.tables(numbers).items():
        for form, text in (("csv", table.csv()), ("md", table.markdown())):
            file = out / TABLES / f"{_joined(item, name)}.{form}"
            file.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(file) as writing:
                writing.write(text.encode())
            files.append(f"{TABLES}/{file.name}")
    with style():
        for name, figure in item.figures(numbers).items():
            for form in ("pdf", "png"):
                file = out / FIGURES / f"{_joined(item, name)}.{form}"
                save(figure, file)
                files.append(f"{FIGURES}/{file.name}")
    return files


def _joined(item: Item, name: str) -> str:
    return f"{item.stem}-{name}" if name else item.stem
