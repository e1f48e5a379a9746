"""MBTL with expected improvement, the paper's other acquisition (method, sections 2 and 5.8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mbtl.selectors.mbtl import MBTL


@dataclass(frozen=True)
class MBTLEI(MBTL):
    """`MBTL` whose acquisition is E_x' [ m Phi(m/s) + s phi(m/s) ]; see `expected_gain`."""

    acquisition: Literal["ucb", "ei"] = "ei"
    name: str = "mbtl-ei"
