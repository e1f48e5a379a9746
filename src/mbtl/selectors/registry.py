"""Selectors by name."""

from __future__ import annotations

from collections.abc import Callable

from mbtl.errors import InvalidInput, check_known
from mbtl.faults import FAULTS, load_object, reason_of
from mbtl.selectors.clustering import KMeansSelector
from mbtl.selectors.contract import Proposes, Selector, adopted
from mbtl.selectors.equidistant import Equidistant
from mbtl.selectors.gp_mbtl import GPMBTL
from mbtl.selectors.greedy import Greedy
from mbtl.selectors.m_mbtl import MMBTL
from mbtl.selectors.mbtl import MBTL, MBTLEI
from mbtl.selectors.mbtl_release import MBTLRelease
from mbtl.selectors.random import Random
from mbtl.selectors.sd_mbtl import SDMBTL
from mbtl.selectors.specialists import Specialists
from mbtl.selectors.worst_first import WorstFirst

_FACTORIES: dict[str, Callable[[], Selector]] = {
    "specialists": Specialists,
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


def get_selector(selector: str | Proposes) -> Selector:
    """A selector by registered name or by where a user's own is, or the given selector itself.

    Args:
        selector: e.g. "mbtl"; "my_selectors.py:Mine" or "package.module:Mine", which may be a
            class or function that makes one without arguments, or the selector itself; an object
            with `propose`.

    Raises:
        UnknownName: no selector has this name.
        InvalidInput: what is there is no selector, or cannot be imported or made.
    """
    if not isinstance(selector, str):
        return adopted(selector)
    if is_own(selector):
        return _own(selector)
    check_known("selector", selector, _FACTORIES)
    return _FACTORIES[selector]()


def is_own(name: str) -> bool:
    """Whether it says where a user's own selector is, or tries to."""
    return ":" in name or name.endswith(".py")


def _own(reference: str) -> Selector:
    found = load_object(reference)
    if isinstance(found, type) or (callable(found) and not isinstance(found, Proposes)):
        try:
            found = found()
        except FAULTS as error:
            raise InvalidInput(
                f"{reference!r} must make a selector when called without arguments, got "
                f"{reason_of(error)}; name a selector made with them instead"
            ) from error
    return adopted(found)
