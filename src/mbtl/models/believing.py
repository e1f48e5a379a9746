"""A transfer posterior that believes some trainings, of which nothing is known, to go as expected.

While trainings are under way, the next source is chosen as if they had given what is expected of
them. A believed value changes no mean and no residual: it only makes the model surer around it.
So a batch is a growing Cholesky factor of which the rows told are the first block,

    L = [ L11   0  ]    L21 = (L11^-1 K12)^T      L22 L22^T = K22 + noise - L21 L21^T
        [ L21  L22 ]

and what was solved for a candidate before, L^-1 k, grows by the new rows alone: one more pick of a
batch costs O(n) per believed pair and query instead of O(n^2) per query.

Notation (shapes): n pairs told and believed, m pairs believed anew, T targets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbtl.arrays import Array
from mbtl.models.transfer_gp import TransferGP, half_solved, scale_of
from mbtl.models.transfer_kernel import NEW, Pairs, covariance, grid_pairs, variance

_MOST_ENTRIES = 1 << 25
"""Numbers kept of what was solved, 256 MiB; what was not asked for the longest goes first."""
_SPARE = 64
"""Rows that a kept table may grow by before it is copied."""


@dataclass
class _Solved:
    """Of one candidate and T targets.

    Attributes:
        half: (>= rows, T) L^-1 k, of which `rows` rows are there.
        rows: how many of the n pairs they are of.
        explained: (T,) squares of `half`, summed over the rows.
        mean: (T,) of J.
    """

    half: Array
    rows: int
    explained: Array
    mean: Array


class Believing(TransferGP):
    """The posterior `told`, and what it believes since; `believe` adds to that.

    Args:
        told: of the rows told, as it is.
    """

    def __init__(self, told: TransferGP) -> None:
        self._places, self._prior, self._pairs = told._places, told._prior, told._pairs
        self._chol, self._residual, self._ones = told._chol, told._residual, told._ones
        self.mean, self.scale, self.log_likelihood = told.mean, told.scale, told.log_likelihood
        self._solved: dict[bytes, dict[int, _Solved]] = {}
        self._entries = 0
        self._told = len(told._pairs)

    @property
    def believed(self) -> Pairs:
        """(m, 3) pairs that nobody has told."""
        return self._pairs[self._told :]

    def believe(self, pairs: Pairs) -> None:
        """From now on these pairs count as seen, with the values expected of them.

        Raises:
            numpy.linalg.LinAlgError: they say no more than what is there already.
        """
        places, prior, n = self._places, self._prior, len(self._pairs)
        across = half_solved(self._chol, covariance(places, prior, self._pairs, pairs))
        own = covariance(places, prior, pairs, pairs) - across.T @ across
        own[np.diag_indices_from(own)] += prior.noise
        corner = np.asarray(np.linalg.cholesky(own), np.float64)
        chol = np.zeros((n + len(pairs), n + len(pairs)))
        chol[:n, :n], chol[n:, :n], chol[n:, n:] = self._chol, across.T, corner
        ones = half_solved(corner, 1.0 - across.T @ self._ones)
        self._chol, self._ones = chol, np.append(self._ones, ones)
        self._residual = np.append(self._residual, np.zeros(len(pairs)))
        self._pairs = np.vstack([self._pairs, pairs])
        self.scale = scale_of(float(self._residual @ self._residual), len(self._pairs))

    def predict(
        self, sources: Pairs, targets: Pairs, trainings: Pairs | None = None
    ) -> tuple[Array, Array]:
        """As `TransferGP.predict`; what was solved for new trainings before is used again."""
        if trainings is not None:
            return super().predict(sources, targets, trainings)
        solved = self._of(sources, targets)
        own = variance(self._prior)
        left = np.maximum(own - np.array([one.explained for one in solved]), 1e-9 * own)
        return np.array([one.mean for one in solved]), np.sqrt(self.scale * left)

    def means(self, sources: Pairs, targets: Pairs) -> Array:
        """(M, T) means of new trainings alone, which nothing believed changes."""
        kept = self._solved.get(targets.tobytes(), {})
        if any(int(source) not in kept for source in sources):
            return self.predict(sources, targets)[0]
        return np.array([kept[int(source)].mean for source in sources])

    # ---- inside ------------------------------------------------------------------------------

    def _of(self, sources: Pairs, targets: Pairs) -> list[_Solved]:
        """What is solved for each source, up to the newest pair."""
        kept, count = self._solved.setdefault(targets.tobytes(), {}), len(targets)
        new = []
        for source in map(int, sources):
            if source in kept:
                kept[source] = kept.pop(source)  # the latest ones come last
            else:
                new.append(source)
        self._make_room(len(new) * count * (len(self._pairs) + _SPARE), keep=sources)
        size = max(1, (1 << 22) // max(count * len(self._pairs), 1))
        for start in range(0, len(new), size):
            self._solve(new[start : start + size], targets, kept)
        old: dict[int, list[int]] = {}
        for source in map(int, sources):
            old.setdefault(kept[source].rows, []).append(source)
        for rows, some in old.items():
            if rows < len(self._pairs):
                self._grow(some, targets, kept, rows)
        return [kept[int(source)] for source in sources]

    def _make_room(self, needed: int, keep: Pairs) -> None:
        wanted = set(keep.tolist())
        for kept in self._solved.values():
            for source in [one for one in kept if one not in wanted]:
                if self._entries + needed <= _MOST_ENTRIES:
                    return
                self._entries -= kept.pop(source).half.size

    def _kernel(self, sources: list[int], targets: Pairs, rows: int) -> Array:
        """(n - rows, M T) covariances of the pairs from number `rows` on with new trainings."""
        asked = grid_pairs(np.array(sources), targets, np.full(len(sources), NEW))
        return covariance(self._places, self._prior, self._pairs[rows:], asked)

    def _solve(self, sources: list[int], targets: Pairs, kept: dict[int, _Solved]) -> None:
        n, count = len(self._pairs), len(targets)
        half = half_solved(self._chol, self._kernel(sources, targets, 0))
        means = self.mean + self._residual @ half
        for i, source in enumerate(sources):
            some = slice(i * count, (i + 1) * count)
            table = np.empty((n + _SPARE, count))
            table[:n] = half[:, some]
            squares = np.einsum("ij,ij->j", table[:n], table[:n])
            kept[source] = _Solved(table, n, squares, means[some])
            self._entries += table.size

    def _grow(
        self, sources: list[int], targets: Pairs, kept: dict[int, _Solved], rows: int
    ) -> None:
        n, count = len(self._pairs), len(targets)
        right = self._kernel(sources, targets, rows)
        below = self._chol[rows:, :rows]
        for i, source in enumerate(sources):
            right[:, i * count : (i + 1) * count] -= below @ kept[source].half[:rows]
        half = half_solved(self._chol[rows:, rows:], right)
        for i, source in enumerate(sources):
            one, some = kept[source], half[:, i * count : (i + 1) * count]
            if n > len(one.half):
                table = np.empty((n + _SPARE, count))
                table[:rows] = one.half[:rows]
                self._entries += table.size - one.half.size
                one.half = table
            one.half[rows:n] = some
            one.explained = one.explained + np.einsum("ij,ij->j", some, some)
            one.rows = n
