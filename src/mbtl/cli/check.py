"""`mbtl check`: does a CMDP, ours or yours, keep the contract?"""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from mbtl.cli.common import JsonFlag, console, print_json, printer
from mbtl.problems import check_cmdp, resolve_cmdp

_STYLE = {"passed": "green", "warning": "yellow", "failed": "bold red"}


def check(
    target: Annotated[
        str, typer.Argument(help="A CMDP id; of your own, module:cmdp (or path.py:cmdp).")
    ],
    steps: Annotated[
        int | None, typer.Option(help="Environment steps per rollout; default: the CMDP's, or 200.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of resets and actions.")] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Check that every axis acts, contexts do not leak, resets are deterministic, numbers finite.

    Example: mbtl check my_simulator.py:problem
    """
    length = "" if steps is None else f", {steps} steps per rollout"
    console.print(Text(f"checking {target}{length}", "dim"))
    report = check_cmdp(
        resolve_cmdp(target),
        steps=steps,
        seed=seed,
        on_check=lambda line: console.print(Text(f"  {line}", "dim")),
    )
    if as_json:
        print_json({"target": target, **report.to_json()})
    else:
        table = Table(box=None, show_header=False, pad_edge=False)
        for found in report.checks:
            outcome = Text(found.outcome, _STYLE[found.outcome])
            table.add_row(outcome, Text(found.name), Text(found.detail))
        printer().print(table)
        printer().print(Text(f"{report.subject}: {report.said}"))
    report.raise_if_failed()
