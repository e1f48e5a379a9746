"""Strategies by name; every selector is one."""

from __future__ import annotations

from collections.abc import Callable

from mbtl.errors import unknown_name
from mbtl.selectors import get_selector, selector_names
from mbtl.selectors.contract import Proposes, Selector
from mbtl.selectors.registry import is_own
from mbtl.strategies.all_first import AllFirst
from mbtl.strategies.auto import Auto
from mbtl.strategies.one_policy import OnePolicy

_FACTORIES: dict[str, Callable[[], Selector]] = {
    "auto": Auto,
    "all-first": AllFirst,
    "one-policy": OnePolicy,
}


def strategy_names() -> list[str]:
    """Names that `get_strategy` takes, selectors among them."""
    return [*_FACTORIES, *selector_names()]


def get_strategy(strategy: str | Proposes) -> Selector:
    """A strategy by name, by where a user's own is, or the given one; see `get_selector`.

    Raises:
        UnknownName: nothing has this name.
        InvalidInput: what is there is no strategy, or cannot be imported or made.
    """
    if isinstance(strategy, str) and strategy in _FACTORIES:
        return _FACTORIES[strategy]()
    if isinstance(strategy, str) and not is_own(strategy) and strategy not in selector_names():
        raise unknown_name("strategy", strategy, strategy_names())
    return get_selector(strategy)
