"""The paper's experiments from transfer matrices: numbers, tables, figures, and a verdict on each.

    mbtl reproduce --out reproduction

Every item computes numbers first and draws tables and figures from them (`item`).
"""

from mbtl.zoo.reproduction.bench import Bench, Setting
from mbtl.zoo.reproduction.item import Item
from mbtl.zoo.reproduction.paper import Value, published
from mbtl.zoo.reproduction.runner import ITEMS, Outcome, items_named, perform

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
