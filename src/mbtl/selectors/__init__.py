"""Selectors: propose the next source from a problem and the rows seen so far."""

from mbtl.selectors.base import (
    Exhausted,
    Proposal,
    SelectionProblem,
    default_theta,
    nearest_distance,
    open_candidates,
)
from mbtl.selectors.clustering import KMeansSelector
from mbtl.selectors.contract import (
    LearnedSelector,
    Proposes,
    Selector,
    Traits,
    check_proposal,
    traits_of,
    without_family,
)
from mbtl.selectors.equidistant import Equidistant
from mbtl.selectors.gp_mbtl import GPMBTL
from mbtl.selectors.greedy import Greedy
from mbtl.selectors.m_mbtl import MMBTL
from mbtl.selectors.mbtl import MBTL, MBTLEI
from mbtl.selectors.mbtl_release import MBTLRelease
from mbtl.selectors.random import Random
from mbtl.selectors.registry import get_selector, selector_names
from mbtl.selectors.sd_mbtl import SDMBTL
from mbtl.selectors.specialists import Specialists
from mbtl.selectors.targets import spread_targets
from mbtl.selectors.worst_first import WorstFirst

__all__ = [
    "GPMBTL",
    "MBTL",
    "MBTLEI",
    "MMBTL",
    "SDMBTL",
    "Equidistant",
    "Exhausted",
    "Greedy",
    "KMeansSelector",
    "LearnedSelector",
    "MBTLRelease",
    "Proposal",
    "Proposes",
    "Random",
    "SelectionProblem",
    "Selector",
    "Specialists",
    "Traits",
    "WorstFirst",
    "check_proposal",
    "default_theta",
    "get_selector",
    "nearest_distance",
    "open_candidates",
    "selector_names",
    "spread_targets",
    "traits_of",
    "without_family",
]
