"""SD-MBTL (M/GP-MBTL): look at the structure of the rows seen, then cover or model.

    J(x, y) = C + f(x) + g(y) + h(x, y)

A *mountain* is constant source quality f with an h that falls with distance; there M-MBTL is the
rule, else GP-MBTL. Source: SD-MBTL (AAAI 2026).

Notation (shapes): k rows observed, N targets, D columns of grid steps.
    centred  (k, N)  J[s, y] less the mean of column y over the sources seen: removes g and C
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import InvalidInput
from mbtl.history import History
from mbtl.models.directional_gap import DirectionalGap, fit_directional_gap
from mbtl.selectors.base import Proposal, SelectionProblem, open_candidates
from mbtl.selectors.contract import Traits
from mbtl.selectors.gp_mbtl import GPMBTL
from mbtl.selectors.m_mbtl import MMBTL


@dataclass(frozen=True, eq=False)
class Structure:
    """What the rows seen say about f and h.

    Attributes:
        own: standard deviation over sources of the centred training performance.
        spread: standard deviation over targets of a centred row, mean over sources.
        gap: slopes of the piecewise linear gap, each target having a level of its own.
    """

    own: float
    spread: float
    gap: DirectionalGap

    @property
    def is_mountain(self) -> bool:
        """Whether f varies less than transfer does, and return falls both ways along all axes.

        own < spread, and left_q > 0 > right_q.
        """
        falls = (self.gap.left > 0) & (self.gap.right < 0)
        return bool(self.own < self.spread and falls.all())


@dataclass(frozen=True)
class SDMBTL:
    """M-MBTL while it is early or the rows look like a mountain, else GP-MBTL.

    Rounds 1 to `look_after` are M-MBTL's; from then on the rows are judged anew at every pick.

    Where the publication contradicts itself or slips, this is the sound form. *All* axes must fall
    with distance, as its text says; its code, and so its tables, ask for more than half of them,
    which lets worlds pass that are directional on a minority of axes. They
    must *fall*: there any two opposite signs would do, which a valley has too. Nothing is kept
    between picks, so M-MBTL never mixes new costs with those from before a round of GP-MBTL. The
    slopes are fitted with a level for each target; fitted as published, centred rows against
    differences that are not centred, trends come out half as steep or less, and directional worlds
    look like mountains. Kept, because harmless: the threshold 1, and a judgement that may change at
    every round.

    Attributes:
        look_after: rows needed before the structure is judged (published: 6).
        cover: the rule for mountains.
        model: the rule for everything else.
    """

    look_after: int = 6
    cover: MMBTL = field(default_factory=MMBTL)
    model: GPMBTL = field(default_factory=GPMBTL)
    name: str = "sd-mbtl"
    traits: ClassVar[Traits] = Traits(deterministic=True)

    def __post_init__(self) -> None:
        if self.look_after < 2:
            raise InvalidInput(
                f"look_after must be >= 2, got {self.look_after}; one row shows no structure"
            )

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        """The pick of the rule that the rows seen speak for."""
        mask = open_candidates(problem, history)
        found = detect(problem, history) if len(history) >= self.look_after else None
        if found is None or found.is_mountain:
            why = "too early to judge" if found is None else "looks like a mountain"
            proposal = self.cover.propose(problem, history, rng)
        else:
            why = "no mountain"
            proposal = self.model.acquire(problem, history, mask)
        return replace(proposal, reason=f"{why}: {proposal.reason}")


def detect(problem: SelectionProblem, history: History) -> Structure | None:
    """The structure that the rows seen show; None where too little was evaluated to tell.

    Targets that fewer than two policies were evaluated on are left out.
    """
    centred = _centred(history.rows)
    sources = np.asarray(history.sources, dtype=np.intp)
    own = centred[np.arange(len(sources)), sources]
    own = own[np.isfinite(own)]
    known = np.isfinite(centred).sum(axis=1) >= 2
    if len(own) < 2 or not known.any():
        return None
    spread = np.nanstd(centred[known], axis=1).mean()
    steps = problem.steps
    gap = fit_directional_gap(steps[sources], steps, history.rows, per_target=True)
    return Structure(float(own.std()), float(spread), gap)


def _centred(rows: Array) -> Array:
    """(k, N) rows less their column means; NaN where a column has fewer than two entries."""
    seen = np.isfinite(rows)
    count = seen.sum(axis=0)
    mean = np.where(seen, rows, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.asarray(np.where(seen & (count >= 2), rows - mean, np.nan))
