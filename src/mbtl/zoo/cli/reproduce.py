"""`mbtl reproduce`: the paper's experiments from transfer matrices, and a verdict on each claim."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.table import Table
from rich.text import Text

from mbtl.cli.common import JsonFlag, console, print_json, printer
from mbtl.errors import InvalidInput, MbtlError
from mbtl.files import claimed_folder
from mbtl.zoo.benchmark.shipped import DEFAULT
from mbtl.zoo.cli.shared import bar
from mbtl.zoo.reproduction import Bench, Item, Outcome, Setting, items_named, perform
from mbtl.zoo.reproduction.claims import Claim, claims_of
from mbtl.zoo.reproduction.page import write_index, write_page
from mbtl.zoo.reproduction.paper import METHODS

_HEADS = {
    "independent": "Indep.",
    "multitask": "Multi",
    "random": "Random",
    "greedy": "Greedy",
    "mbtl": "MBTL",
    "sequential_oracle": "Seq.or.",
    "oracle_transfer": "Oracle",
    "one_policy": "Multi, K",
}
_OUT = Path("runs/reproduction")


def reproduce_command(
    cmdp: Annotated[
        list[str] | None, typer.Argument(help="Ids of CMDPs; default: all 22 of the paper.")
    ] = None,
    item: Annotated[
        list[str] | None,
        typer.Option(help="Number or name of an item; repeat for more. Default: all."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the results; default: below runs/, named by the options."),
    ] = None,
    budget: Annotated[int, typer.Option(help="Number of trainings K.")] = 15,
    variant: Annotated[
        str, typer.Option(help="Set of matrices: default, hidden, final, ...")
    ] = DEFAULT,
    folder: Annotated[
        Path | None, typer.Option(help="Folder of matrices you built; default: the shipped ones.")
    ] = None,
    page: Annotated[
        Path | None,
        typer.Option(help="Also write the page of the reproduction, and its pictures beside it."),
    ] = None,
    again: Annotated[
        bool, typer.Option("--again", help="Make all items again, also those that are finished.")
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Regenerate the tables and claims of the paper from transfer matrices: nothing is trained.

    Tables are CSV and Markdown, figures PDF and PNG, all drawn from numbers in JSON.
    Finished items are kept; interrupt it at any time, the same command goes on where it was.

    Example: mbtl reproduce cartpole-length --item 1 --item curves

    Of matrices that you built (`mbtl matrix build`): mbtl reproduce --folder matrices
    """
    if budget < 1:
        raise InvalidInput(f"--budget must be >= 1, got {budget}")
    if page is not None and (item or cmdp):
        raise InvalidInput("--page needs all items of all CMDPs; leave out --item and the ids")
    items = items_named(item or [])
    ids = tuple(cmdp) if cmdp else None
    place = out or _default_place(ids, budget, variant, folder)
    bench = Bench(Setting(ids, budget, variant, folder))
    _check_something_there(bench, variant)
    with claimed_folder(place, bench.setting.to_json(), "a reproduction"):
        outcomes = _perform(items, bench, place, again=again)
        claims = claims_of({o.item.name: o.numbers for o in outcomes if o.status != "failed"})
        write_index(place / "README.md", outcomes, claims)
        if page is not None:
            write_page(page, bench, outcomes, claims, place)
    if as_json:
        table = next((o.numbers for o in outcomes if o.item.name == "main-table"), {})
        print_json(
            {
                "budget": budget,
                "out": str(place),
                "rows": [row for row in table.get("rows", []) if row["ours"] is not None],
                "items": [outcome.to_json() for outcome in outcomes],
                "claims": [claim.to_json() for claim in claims],
            }
        )
    else:
        _show(outcomes, claims, place)
    failed = [outcome.item.name for outcome in outcomes if outcome.status == "failed"]
    if failed:
        raise MbtlError(
            f"{len(failed)} of {len(outcomes)} items failed ({', '.join(failed)}); the others are "
            f"in {place}, with a traceback of each failure; mend the cause and run it again"
        )


def _default_place(
    ids: tuple[str, ...] | None, budget: int, variant: str, folder: Path | None
) -> Path:
    parts = ["" if ids is None else "-".join(ids), "" if budget == 15 else f"k{budget}"]
    parts += ["" if variant == DEFAULT else variant, "" if folder is None else folder.name]
    return _OUT.with_name("-".join([_OUT.name, *filter(None, parts)]))


def _check_something_there(bench: Bench, variant: str) -> None:
    if bench.available():
        return
    if variant != DEFAULT:
        raise InvalidInput(
            f"there are no matrices of the variant {variant!r}; build them with `mbtl matrix build`"
        )
    first = bench.ids[0]
    raise InvalidInput(
        f"there is no transfer matrix of {', '.join(bench.ids)} yet; build one with `mbtl matrix "
        f"build {first}`, then give its folder with --folder"
    )


def _perform(items: Sequence[Item], bench: Bench, place: Path, *, again: bool) -> list[Outcome]:
    done: list[Item] = []
    with bar("items", len(items)) as tell:

        def says(text: str) -> None:
            tell(len(done), len(items), text)

        def on_item(item: Item, outcome: Outcome | None) -> None:
            if outcome is None:
                says(f"item {item.number}: {item.title}")
                return
            done.append(item)
            line = f"item {item.number:>2}  {outcome.status:<6}  {outcome.seconds:6.1f} s  "
            line += item.title + ("" if outcome.error is None else f": {outcome.error}")
            style = "red" if outcome.error else None
            console.print(line, style=style, markup=False, highlight=False, soft_wrap=True)

        bench.says = says
        return perform(items, bench, place, on_item, again=again)


def _show(outcomes: Sequence[Outcome], claims: Sequence[Claim], place: Path) -> None:
    screen = printer()
    for outcome in outcomes:
        if outcome.item.name == "main-table" and outcome.status != "failed":
            screen.print(_table(outcome.numbers))
    for claim in claims:
        screen.print(f"{claim.verdict:<14} {claim.title}: {claim.found}", markup=False,
                     highlight=False, soft_wrap=True)  # fmt: skip
    missing = list(dict.fromkeys(line for outcome in outcomes for line in outcome.missing))
    for line in missing:
        screen.print(line, style="dim", markup=False, highlight=False, soft_wrap=True)
    screen.print(f"all results: {place / 'README.md'}", markup=False, highlight=False)


def _table(numbers: dict[str, Any]) -> Table:
    table = Table(
        title=Text(f"V at K = {numbers['budget']}, mean over seeds (the paper: 3 trials, K = 15)"),
        box=box.SIMPLE,
        padding=(0, 1, 0, 0),
        show_edge=False,
    )
    table.add_column("CMDP", no_wrap=True)
    for method in METHODS:
        table.add_column(_HEADS[method], justify="right", no_wrap=True)
    for row in numbers["rows"]:
        for name, key, style in ((row["cmdp"], "ours", None), ("  paper", "published", "dim")):
            if row[key] is not None or key == "ours":
                table.add_row(Text(name), *(_mean(row[key], m) for m in METHODS), style=style)
    return table


def _mean(values: dict[str, Any] | None, method: str) -> str:
    return "-" if values is None or method not in values else f"{values[method]['mean']:.4f}"
