"""Contexts: axes, spaces and grids; value <-> unit cube <-> grid steps."""

from mbtl.contexts.axes import Axis, Categorical, Integer, Linear, Log, Value
from mbtl.contexts.space import Context, ContextSpace

__all__ = ["Axis", "Categorical", "Context", "ContextSpace", "Integer", "Linear", "Log", "Value"]
