"""The items by number: the paper's experiments in its order."""

from __future__ import annotations

from collections.abc import Sequence

from mbtl.errors import unknown_name
from mbtl.reproduction.item import Item
from mbtl.reproduction.items import (
    curves,
    elimination,
    gap_correlation,
    gp_evolution,
    gp_study,
    heatmaps,
    main_table,
    multitask_rivals,
    per_context,
    policy_map,
    sample_complexity,
    sensitivity,
    transfer_curves,
)

ITEMS: tuple[Item, ...] = (
    main_table.ITEM,
    sample_complexity.ITEM,
    curves.ITEM,
    per_context.ITEM,
    heatmaps.ITEM,
    gp_evolution.ITEM,
    policy_map.ITEM,
    sensitivity.ITEM,
    gap_correlation.ITEM,
    multitask_rivals.ITEM,
    elimination.ITEM,
    transfer_curves.ITEM,
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
