"""Building every matrix that a reproduction needs, by the commands that build one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mbtl.cli.build import build
from mbtl.cli.common import console
from mbtl.cli.multitask import multitask
from mbtl.cmdps import cmdp_ids, get_cmdp
from mbtl.errors import InvalidInput, unknown_name
from mbtl.reproduction import Item
from mbtl.reproduction.items.sensitivity import ALGORITHMS, CMDP

_RIVALS = ("paco", "moore")


def build_all(
    ids: Sequence[str], tier: str | None, out: Path, work: Path, items: Sequence[Item]
) -> None:
    """Build what is missing: a matrix and a multi-task baseline per CMDP, and what items add.

    Args:
        ids: CMDPs.
        tier: preset of their recipes; None: the default of each. A CMDP without such a preset is
            built with its default, and that is said.
        out: folder of the finished files.
        work: folder of unfinished ones.
        items: whose further sets are built, too.
    """
    known = sorted({name for id in cmdp_ids() for name in get_cmdp(id).presets})
    if tier is not None and tier not in known:
        raise unknown_name("tier", tier, known)
    for id in ids:
        if id not in cmdp_ids():
            raise InvalidInput(f"--from-scratch builds our own CMDPs, got {id!r}")
    numbers = {item.number for item in items}
    for id in ids:
        preset = _preset(id, tier)
        build(id, preset=preset, out=out, work=work)
        multitask(id, preset=preset, out=out / "multitask", work=work)
        if 10 in numbers and id.startswith("cartpole"):
            for method in _RIVALS:
                multitask(id, method=method, preset=preset, out=out / "multitask", work=work)
        if 8 in numbers and id == CMDP:
            for name, variant in ALGORITHMS.items():
                if variant is not None:
                    build(id, preset=preset, algorithm=name, out=out, work=work)


def _preset(id: str, tier: str | None) -> str:
    cmdp = get_cmdp(id)
    if tier is None or tier in cmdp.presets:
        return tier or cmdp.default_preset
    console.print(
        f"{id} has no recipe {tier!r}; its default {cmdp.default_preset!r} is used",
        markup=False, highlight=False, soft_wrap=True,
    )  # fmt: skip
    return cmdp.default_preset
