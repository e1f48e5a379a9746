"""The paper's experiments from transfer matrices: numbers, tables, figures, and a verdict on each.

    mbtl reproduce --out reproduction

Every item computes numbers first and draws tables and figures from them (`mbtl.reproduction.item`).
"""

from mbtl.reproduction.bench import Bench, Setting
from mbtl.reproduction.item import Item
from mbtl.reproduction.paper import Value, published
from mbtl.reproduction.runner import ITEMS, Outcome, items_named, perform

__all__ = [
    "ITEMS",
    "Bench",
    "Item",
    "Outcome",
    "Setting",
    "Value",
    "items_named",
    "perform",
    "published",
]
