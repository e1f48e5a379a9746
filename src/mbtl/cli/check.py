"""`mbtl check`: does a CMDP, ours or yours, keep the contract?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from mbtl.cli.common import JsonFlag, console, print_json, printer
from mbtl.contexts import Axis, Categorical, ContextSpace, Linear
from mbtl.errors import InvalidInput
from mbtl.problems import CMDP, check_cmdp, load_object, resolve_cmdp

_STYLE = {"passed": "green", "warning": "yellow", "failed": "bold red"}
_FORM = "NAME=LOW:HIGH, NAME=LOW:HIGH:UNIT or NAME=a,b,c"


def check(
    target: Annotated[
        str,
        typer.Argument(
            help="A CMDP id; of your own, module:cmdp or module:make_env (or path.py:name)."
        ),
    ],
    axis: Annotated[
        list[str] | None,
        typer.Option(help=f"An axis for make_env: {_FORM}; repeat for more.", show_default=False),
    ] = None,
    steps: Annotated[
        int | None, typer.Option(help="Environment steps per rollout; default: the CMDP's, or 200.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of resets and actions.")] = 0,
    json: JsonFlag = False,
) -> None:
    """Check that every axis acts, contexts do not leak, resets are deterministic, numbers finite.

    Example: mbtl check my_simulator:make_env --axis length=0.1:2.0:m
    """
    found: Any = load_object(target) if ":" in target else resolve_cmdp(target)
    space = None
    if not isinstance(found, CMDP):
        space = _contexts(found, target, axis or [])
    elif axis:
        raise InvalidInput(f"{target!r} has its axes already; --axis goes with module:make_env")
    length = "" if steps is None else f", {steps} steps per rollout"
    console.print(Text(f"checking {target}{length}", "dim"))
    report = check_cmdp(
        found,
        space,
        steps=steps,
        seed=seed,
        on_check=lambda line: console.print(Text(f"  {line}", "dim")),
    )
    if json:
        print_json({"target": target, **report.to_json()})
    else:
        _print(report)
    report.raise_if_failed()


def _contexts(made: Any, target: str, axes: Sequence[str]) -> ContextSpace:
    """Contexts of a user's environment factory."""
    if not callable(made):
        raise InvalidInput(
            f"{target!r} must be a CMDP or a function context -> environment, got {type(made)}"
        )
    if not axes:
        raise InvalidInput(
            f"{target!r} is a function, so its axes are needed, got none; add --axis {_FORM}"
        )
    # Three values per numeric axis: both ends are compared, around the middle of the others.
    parsed = map(parse_axis, axes)
    return ContextSpace.grid({a: a.width if isinstance(a, Categorical) else 3 for a in parsed})


def parse_axis(text: str) -> Axis:
    """An axis from `NAME=LOW:HIGH`, `NAME=LOW:HIGH:UNIT` or `NAME=a,b,c`.

    Raises:
        InvalidInput: another form, or LOW >= HIGH.
    """
    name, _, values = text.partition("=")
    if name and "," in values:
        return Categorical(name, tuple(_number_or_name(v) for v in values.split(",")))
    parts = values.split(":", 2)
    try:
        low, high = float(parts[0]), float(parts[1])
    except (ValueError, IndexError):
        raise InvalidInput(f"an axis is written {_FORM}, got {text!r}") from None
    return Linear(name, low, high, parts[2] if len(parts) > 2 else "")


def _number_or_name(text: str) -> float | int | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text.strip()


def _print(report: Any) -> None:
    table = Table(box=None, show_header=False, pad_edge=False)
    for found in report.checks:
        style = _STYLE[found.outcome]
        table.add_row(Text(found.outcome, style), Text(found.name), Text(found.detail))
    out = printer()
    out.print(table)
    out.print(Text(f"{report.subject}: {report.said}"))
