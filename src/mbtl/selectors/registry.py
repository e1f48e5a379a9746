"""Selectors by name."""

from __future__ import annotations

from collections.abc import Callable

from mbtl.errors import unknown_name
from mbtl.selectors.auto import Auto
from mbtl.selectors.base import Selector
from mbtl.selectors.clustering import KMeansSelector
from mbtl.selectors.equidistant import Equidistant
from mbtl.selectors.gp_mbtl import GPMBTL
from mbtl.selectors.greedy import Greedy
from mbtl.selectors.m_mbtl import MMBTL
from mbtl.selectors.mbtl import MBTL
from mbtl.selectors.mbtl_ei import MBTLEI
from mbtl.selectors.mbtl_release import MBTLRelease
from mbtl.selectors.random import Random
from mbtl.selectors.sd_mbtl import SDMBTL
from mbtl.selectors.worst_first import WorstFirst

_FACTORIES: dict[str, Callable[[], Selector]] = {
    "auto": Auto,
    "mbtl": MBTL,
    "mbtl-release": MBTLRelease,
    "mbtl-ei": MBTLEI,
    "random": Random,
    "greedy": Greedy,
    "equidistant": Equidistant,
    "worst-first": WorstFirst,
    "gp-mbtl": GPMBTL,
    "m-mbtl": MMBTL,
    "sd-mbtl": SDMBTL,
    "kmeans": KMeansSelector,
}


def selector_names() -> list[str]:
    """Names that `get_selector` takes."""
    return list(_FACTORIES)


def get_selector(selector: str | Selector) -> Selector:
    """A selector by registered name, or the given selector itself.

    Raises:
        UnknownName: no selector has this name.
    """
    if not isinstance(selector, str):
        return selector
    if selector not in _FACTORIES:
        raise unknown_name("selector", selector, _FACTORIES)
    return _FACTORIES[selector]()
