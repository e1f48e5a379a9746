"""`mbtl report`: a page of studies and matrices, one file that needs nothing else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from mbtl.cli.common import JsonFlag, print_json, printer
from mbtl.cli.study import open_study
from mbtl.errors import InvalidInput, unknown_name
from mbtl.provider import laboratory
from mbtl.report import Subject, of_study, write_page
from mbtl.study import Study
from mbtl.study.database import check_path


def report(
    subjects: Annotated[
        list[str],
        typer.Argument(
            metavar="STUDY|MATRIX...",
            help="Folders, files or URLs of studies, .npz files, ids of shipped matrices.",
        ),
    ],
    name: Annotated[
        list[str] | None,
        typer.Option(help="Name of a study, where its database holds several; repeat for more."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write.")] = Path("report.html"),
    selector: Annotated[
        str, typer.Option(help="Rule that is replayed on a matrix; of a study its own is shown.")
    ] = "specialists",
    budget: Annotated[int, typer.Option(help="Number of trainings K on a matrix.")] = 15,
    seed: Annotated[int, typer.Option(help="Matrix seed that is replayed.")] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Write a page with everything that a study or a transfer matrix shows.

    It holds V against the trainings, who serves which context, what the model believed after each
    training, what to train next, costs and provenance. Send it to anybody; it needs no network.

    Example: mbtl report runs/cartpole-length-quick-seed0 pendulum-length -o report.html

    Of a server: mbtl report postgresql+psycopg://me@db/studies --name first --name second
    """
    if out.suffix != ".html" or out.is_dir():
        raise InvalidInput(f"--out must be a file that ends in .html, got {str(out)!r}")
    replayed = partial(laboratory().subject, selector=selector, budget=budget, seed=seed)
    opened = [one for given in subjects for one in _open(given, name or [None], replayed)]
    if name and all(isinstance(one, Subject) for one in opened):
        raise InvalidInput(f"--name is of a study, and no study is given, got {name[0]!r}")
    found = [of_study(one) if isinstance(one, Study) else one for one in opened]
    write_page(found, out)
    size = out.stat().st_size
    if as_json:
        print_json({"written": str(out), "bytes": size, "subjects": [one.name for one in found]})
    else:
        printer().print(Text(f"wrote {out} ({size / 1e6:.1f} MB); open it in a browser"))


def _open(
    given: str, names: Sequence[str | None], replayed: Callable[[str], Subject | None]
) -> Sequence[Study | Subject]:
    """What a matrix shows, or the studies of these names; None: the only one."""
    path = Path(given)
    check_path(path)
    if (found := replayed(given)) is not None:
        return [found]
    if "://" in given or path.exists():
        return [open_study(given, name) for name in names]
    raise unknown_name(
        "study or matrix", given, laboratory().subjects(),
        hint="Give the folder of a study, an .npz file, or an id that `mbtl matrix list` shows.",
    )  # fmt: skip
