"""A transfer posterior that grows: rows told one by one, and trainings believed to go as hoped.

While trainings are under way, the next source is chosen as if they had given what is expected of
them. A believed value changes no mean and no residual: it only makes the model surer around it.
More observations, told or believed, are a growing Cholesky factor,

    L = [ L11   0  ]    L21 = (L11^-1 K12)^T      L22 L22^T = K22 + noise - L21 L21^T
        [ L21  L22 ]

and what was solved for a candidate before, L^-1 k, grows by the new rows alone: one more pick costs
O(n) per new pair and query instead of O(n^2) per query. The numbers are those of a model made anew,
but for rounding.

Notation (shapes): n pairs told and believed, m new pairs, T targets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbtl.arrays import Array
from mbtl.models.transfer_gp import TransferGP, half_solved, scale_of, summed_up
from mbtl.models.transfer_kernel import (
    NEW,
    Pairs,
    Places,
    TransferPrior,
    covariance,
    grid_pairs,
    variance,
)

_MOST_ENTRIES = 1 << 25
"""Numbers kept of what was solved, 256 MiB; what was not asked for the longest goes first."""
_SPARE = 256
"""Rows that a kept table may grow by before it is copied."""


@dataclass
class _Solved:
    """Of one candidate and T targets.

    Attributes:
        half: (>= rows, T) L^-1 k, of which `rows` rows are there.
        rows: how many of the n pairs they are of.
        explained: (T,) squares of `half`, summed over the rows.
        mean: (T,) of J.
        telling: number of the telling that `mean` follows from.
    """

    half: Array
    rows: int
    explained: Array
    mean: Array
    telling: int


class Growing(TransferGP):
    """The posterior of the rows told; `tell` and `believe` add to it.

    Args:
        places: of all contexts.
        prior: of the terms.
        pairs: (n, 3) observed.
        y: (n,) performance there, finite.
        noise: (n,) variance of each y around the true mean return, as a multiple of `scale`; None
            for none.

    Attributes:
        y: (n,) performance of the pairs told.
    """

    def __init__(
        self,
        places: Places,
        prior: TransferPrior,
        pairs: Pairs,
        y: Array,
        noise: Array | None = None,
    ) -> None:
        own = prior.noise + (np.zeros(len(y)) if noise is None else noise)
        super().__init__(places, prior, pairs, y, relative=own)
        self.y, self._own_noise = y, own
        self._solved: dict[bytes, dict[int, _Solved]] = {}
        self._entries = 0
        self._told, self._telling = len(pairs), 1

    @property
    def told(self) -> Pairs:
        """(n, 3) pairs that have a value."""
        return self._pairs[: self._told]

    @property
    def believed(self) -> Pairs:
        """(m, 3) pairs that nobody has told."""
        return self._pairs[self._told :]

    @property
    def noisy(self) -> bool:
        """Whether a known noise counts beside that of the prior."""
        return bool((self._own_noise > self._prior.noise).any())

    def grows_into(self, places: Places, pairs: Pairs) -> bool:
        """Whether what was told is the first of these pairs."""
        mine = self._places
        return (
            np.array_equal(self.told, pairs[: self._told])
            and np.array_equal(mine.x, places.x)
            and np.array_equal(mine.z, places.z)
        )

    def believes(self, prior: TransferPrior, noise: Array) -> bool:
        """Whether this is its prior, and its noise that of the first pairs (as in `tell`)."""
        return self._prior == prior and np.array_equal(
            self._own_noise, prior.noise + noise[: self._told]
        )

    def tell(self, pairs: Pairs, y: Array, noise: Array | None = None) -> None:
        """More is known; then what was believed is not believed any more.

        Args:
            pairs: (m, 3) observed since.
            y: (n + m,) performance of all pairs told, the old ones first; they may have changed.
            noise: (m,) as before, of the new ones.

        Raises:
            numpy.linalg.LinAlgError: K is singular.
        """
        if len(pairs) == 0 and np.array_equal(y, self.y):
            return
        self.doubt()
        own = self._prior.noise + (np.zeros(len(pairs)) if noise is None else noise)
        if len(pairs):
            self._append(pairs, own)
        self.y, self._told = y, len(self._pairs)
        self._telling += 1
        self._own_noise = np.append(self._own_noise, own)
        fit = summed_up(self._chol, self._ones, half_solved(self._chol, y))
        self.mean, self.scale, self.log_likelihood = fit.mean, fit.scale, fit.log_likelihood
        self._residual = fit.residual

    def believe(self, pairs: Pairs) -> None:
        """From now on these pairs count as seen, with the values expected of them.

        Raises:
            numpy.linalg.LinAlgError: they say no more than what is there already.
        """
        self._append(pairs, np.full(len(pairs), self._prior.noise))
        self._residual = np.append(self._residual, np.zeros(len(pairs)))
        self.scale = scale_of(float(self._residual @ self._residual), len(self._pairs))

    def doubt(self) -> None:
        """Nothing is believed any more that was not told."""
        n = self._told
        if len(self._pairs) == n:
            return
        self._chol, self._pairs = self._chol[:n, :n], self._pairs[:n]
        self._ones, self._residual = self._ones[:n], self._residual[:n]
        self.scale = scale_of(float(self._residual @ self._residual), n)
        for kept in self._solved.values():
            for one in kept.values():
                if one.rows > n:
                    one.rows = n
                    one.explained = _squares(one.half[:n])

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

    def smoothed(self) -> Array:
        """(n,) means of J at the pairs told, their noise taken away: y - noise K^-1 (y - mu)."""
        from scipy.linalg import solve_triangular  # kept out of `import mbtl`

        n = self._told
        weights = solve_triangular(
            self._chol[:n, :n], self._residual[:n], lower=True, trans="T", check_finite=False
        )
        return np.asarray(self.y - self._own_noise * weights)

    def means(self, sources: Pairs, targets: Pairs) -> Array:
        """(M, T) means of new trainings alone, which nothing believed changes."""
        kept = self._solved.get(targets.tobytes(), {})
        known = (kept.get(int(source)) for source in sources)
        found = [one.mean for one in known if one is not None and one.telling == self._telling]
        return np.array(found) if len(found) == len(sources) else self.predict(sources, targets)[0]

    # ---- inside ------------------------------------------------------------------------------

    def _append(self, pairs: Pairs, own: Array) -> None:
        """The factor, ones and pairs."""
        places, prior, n = self._places, self._prior, len(self._pairs)
        across = half_solved(self._chol, covariance(places, prior, self._pairs, pairs))
        left = covariance(places, prior, pairs, pairs) - across.T @ across
        left[np.diag_indices_from(left)] += own
        corner = np.asarray(np.linalg.cholesky(left), np.float64)
        chol = np.zeros((n + len(pairs), n + len(pairs)))
        chol[:n, :n], chol[n:, :n], chol[n:, n:] = self._chol, across.T, corner
        ones = half_solved(corner, 1.0 - across.T @ self._ones)
        self._chol, self._ones = chol, np.append(self._ones, ones)
        self._pairs = np.vstack([self._pairs, pairs])

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
        residual = self._residual[: self._told]
        for source in map(int, sources):
            one = kept[source]
            if one.telling != self._telling:
                one.mean = self.mean + residual @ one.half[: self._told]
                one.telling = self._telling
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
        for i, source in enumerate(sources):
            table = np.empty((n + _SPARE, count))
            table[:n] = half[:, i * count : (i + 1) * count]
            kept[source] = _Solved(table, n, _squares(table[:n]), np.empty(0), 0)
            self._entries += table.size

    def _grow(
        self, sources: list[int], targets: Pairs, kept: dict[int, _Solved], rows: int
    ) -> None:
        n, count = len(self._pairs), len(targets)
        right = self._kernel(sources, targets, rows)
        below = np.ascontiguousarray(self._chol[rows:, :rows])
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
            one.explained = one.explained + _squares(some)
            one.rows = n


def _squares(half: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->j", half, half))
