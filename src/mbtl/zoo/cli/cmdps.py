"""`mbtl cmdps`: which contextual MDPs there are."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from mbtl.cli.common import JsonFlag, print_json, printer


def cmdps(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[CMDP]",
            help="Show one: an id, or module:attribute for your own.",
            show_default=False,
        ),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """List the contextual MDPs, or show one with its recipes.

    Example: mbtl cmdps cartpole-length
    """
    from mbtl.problems import cmdp_ids, resolve_cmdp

    if name:
        record = _record(resolve_cmdp(name))
        if as_json:
            print_json(record)
        else:
            _show(record)
        return
    records = [_record(resolve_cmdp(id)) for id in cmdp_ids()]
    if as_json:
        print_json(records)
    else:
        _list(records)


def _record(cmdp: Any) -> dict[str, Any]:
    """What is fixed about a CMDP, as data; the table and the JSON are made from it."""
    from mbtl.problems import cmdp_ids
    from mbtl.zoo.cmdps.registry import paper_bounds

    space = cmdp.space
    return {
        "id": cmdp.id,
        "version": cmdp.version,
        "family": cmdp.family,
        "description": cmdp.description,
        "n": space.n,
        "axes": [axis.to_json() for axis in space.axes],
        "nominal": cmdp.nominal,
        "unit": cmdp.unit,
        "horizon": cmdp.horizon,
        "bounds": cmdp.bounds,
        "paper_bounds": paper_bounds(cmdp.id) if cmdp.id in cmdp_ids() else None,
        "direction": cmdp.direction,
        "floor": cmdp.floor,
        "theta": cmdp.theta,
        "settings": dict(cmdp.settings),
        "default_preset": cmdp.default_preset,
        "presets": _presets(cmdp),
        "presets_elsewhere": _elsewhere(cmdp),
    }


def _presets(cmdp: Any) -> dict[str, Any]:
    return {
        name: {"budget": p.budget, "description": p.description, "trainer": p.options()}
        for name, p in cmdp.presets.items()
    }


def _elsewhere(cmdp: Any) -> dict[str, Any]:
    """Presets of the engines that are not the default, by engine."""
    from mbtl.problems import cmdp_ids, get_cmdp
    from mbtl.zoo.cmdps.registry import engines_of

    own, here = cmdp.id not in cmdp_ids(), cmdp.settings.get("engine")
    others = [] if own else [engine for engine in engines_of(cmdp.id) if engine != here]
    return {engine: _presets(get_cmdp(cmdp.id, engine=engine)) for engine in others}


def _list(records: list[dict[str, Any]]) -> None:
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0), header_style="bold")
    for title in ("CMDP", "axis"):
        table.add_column(title, no_wrap=True)
    for title in ("N", "nominal", "horizon", "returns"):
        table.add_column(title, justify="right", no_wrap=True)
    for record in records:
        nominal = record["nominal"] or {}
        table.add_row(
            record["id"],
            "\n".join(_axis(axis) for axis in record["axes"]),
            str(record["n"]),
            "\n".join(_plain(value) for value in nominal.values()),
            _or_dash(record["horizon"]),
            _bounds(record),
        )
    out = printer()
    out.print(table)
    out.print("\nAll about one, with its presets: mbtl cmdps cartpole-length", highlight=False)
    out.print("Train on one:                    mbtl run cartpole-length", highlight=False)


def _show(record: dict[str, Any]) -> None:
    out = printer()
    about = f"  version {record['version']}  {record['description']}"
    out.print(Text(record["id"], "bold") + Text(about))
    facts = Table(box=None, show_header=False, pad_edge=False)
    for label, text in (
        ("contexts", f"{record['n']}: {_joined(_axis(axis) for axis in record['axes'])}"),
        ("nominal", _values(record["nominal"])),
        ("horizon", _or_dash(record["horizon"])),
        ("returns for performance 0..1", _bounds(record)),
        *_in_the_paper(record["paper_bounds"]),
        ("no return counts as worse than", _or_dash(record["floor"])),
        ("theta, performance per grid step", _or_dash(record["theta"])),
        ("settings", _values(record["settings"])),
    ):
        facts.add_row(label, Text(text))
    out.print(facts)
    default = {record["default_preset"]: " (default)"}
    for name, preset in record["presets"].items():
        _show_preset(name, preset, default.get(name, ""))
    for engine, presets in record["presets_elsewhere"].items():
        for name, preset in presets.items():
            _show_preset(name, preset, f" with --engine {engine}")


def _show_preset(name: str, preset: dict[str, Any], which: str) -> None:
    out = printer()
    about = f"; {preset['description']}" if preset["description"] else ""
    rest = f"{which}: K = {preset['budget']}{about}"
    out.print(Text("\npreset ") + Text(name, "bold") + Text(rest))
    if preset["trainer"]:
        out.print(Text(f"  {_values(preset['trainer'])}"))


def _axis(axis: dict[str, Any]) -> str:
    if axis["kind"] == "categorical":
        return f"{axis['name']} in {_joined(map(str, axis['choices']))}"
    return f"{axis['name']} {axis['low']:g}..{axis['high']:g} {axis['unit']}".rstrip()


def _values(values: dict[str, Any] | None) -> str:
    return _joined(f"{name} {_plain(value)}" for name, value in (values or {}).items()) or "-"


def _plain(value: Any) -> str:
    if isinstance(value, dict):
        return f"({_values(value)})"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _bounds(record: dict[str, Any]) -> str:
    if record["bounds"] is None:
        return "from the returns seen"
    low, high = record["bounds"]
    return f"{low:g}..{high:g}" if record["direction"] == "maximize" else f"{high:g}..{low:g}"


def _in_the_paper(bounds: Any) -> list[tuple[str, str]]:
    if bounds is None:
        return []
    low, high = bounds
    return [("in the paper", f"{low:g}..{high:g}; in tables by --bounds {low:g},{high:g} or seen")]


def _or_dash(value: Any) -> str:
    return "-" if value is None else f"{value:g}"


def _joined(parts: Any) -> str:
    return ", ".join(parts)
