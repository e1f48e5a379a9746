"""Episodes: what the single episodes behind the rows of some policies say of chance.

Every context has episodes of its own, the same for every policy. What is said of a choice is said
by episodes that did not make it: the rows are split into folds, each fold is left out in turn, and
values what the others chose (cross-fitting). The best of noisy rows flatters nobody then.

Notation (shapes): k policies, N contexts, F folds, m pairs of a policy and a context.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from mbtl.arrays import Array, Indices
from mbtl.contexts import Context
from mbtl.errors import TrainingFailed
from mbtl.history import standard_errors
from mbtl.objective import Bounds
from mbtl.plain import LARGEST, floats, refused

_FOLDS = 5
"""At most so many folds; more would cost more and say the same."""
_ENOUGH = 1000
"""Contexts that decide how much luck policies share."""
_MANY = 1e6
"""Degrees of freedom from which on Student's t is the Gaussian; any number may be given."""


class Episodes:
    """The returns of single episodes of k policies, and their scale.

    Args:
        returns: k arrays (N, E_i), raw units; NaN where there is none.
        bounds: that make performance of returns.
    """

    def __init__(self, returns: Sequence[Array], bounds: Bounds) -> None:
        """Nothing is computed yet."""
        self.returns, self.bounds = tuple(returns), bounds

    def __len__(self) -> int:
        return len(self.returns)

    def first(self, k: int) -> Episodes:
        """Those of the first k policies."""
        return Episodes(self.returns[:k], self.bounds)

    @property
    def several(self) -> bool:
        """True where an entry is of several episodes; one alone says nothing of chance."""
        return max(self.counts) > 1

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """(k,) episodes behind each row."""
        return tuple(each.shape[1] for each in self.returns)

    @property
    def fewest(self) -> int:
        """Fewest episodes that a row with several has; 1 where none has."""
        return min((count for count in self.counts if count > 1), default=1)

    @property
    def folds(self) -> int:
        """F."""
        return min(self.fewest, _FOLDS)

    @cached_property
    def errors(self) -> Array | None:
        """(k, N) standard errors of the rows, performance; None: unknown, or there is no noise."""
        if not self.several:
            return None
        width = self.bounds.high - self.bounds.low
        found = np.array([episode_moments(each)[1] for each in self.returns]) / width
        return standard_errors(found, self.counts)

    @cached_property
    def own_share(self) -> float:
        """Share of the noise that a policy has for itself: 1 less the correlation of their luck.

        Measured episode by episode, over all contexts and pairs of policies that have both.
        """
        several = [each for each in self.returns if each.shape[1] > 1]
        if len(several) < 2:
            return 1.0
        n = len(several[0])
        some = np.unique(np.linspace(0, n - 1, min(n, _ENOUGH)).round().astype(np.intp))
        luck = np.array([each[some, : self.fewest] for each in several])
        luck -= luck.mean(axis=2, keepdims=True)
        there = np.isfinite(luck).all(axis=2)
        luck[~there] = 0.0
        squares = np.square(luck).sum(axis=2)
        within = squares @ there.T.astype(float)  # of the one, where the other has them, too
        pairs = np.triu_indices(len(several), 1)
        scale = float(np.sqrt(within * within.T)[pairs].sum())
        together = 0.5 * float(np.square(luck.sum(axis=0)).sum() - squares.sum())
        return 1.0 - float(np.clip(together / scale, 0.0, 1.0)) if scale > 0 else 1.0

    def kept(self, row: Indices, target: Indices) -> Array:
        """(m, F) performance of pairs by all episodes but those of a fold."""
        return self._means(row, target, held=False)

    def held(self, row: Indices, target: Indices) -> Array:
        """(m, F) performance of pairs by the episodes of a fold alone."""
        return self._means(row, target, held=True)

    def _means(self, row: Indices, target: Indices, *, held: bool) -> Array:
        found = np.empty((len(row), self.folds))
        for policy in np.unique(row):
            mine = row == policy
            played = self.returns[policy][target[mine]]
            there = np.isfinite(played)
            played = np.where(there, played, 0.0)
            split = np.arange(played.shape[1])[:, None] % self.folds == np.arange(self.folds)
            among = (split if held else ~split).astype(float)
            count = there @ among
            with np.errstate(divide="ignore", invalid="ignore"):
                mean = (played @ among) / count
                whole = played.sum(axis=1) / there.sum(axis=1)
            # a row of one episode among rows of several is the same in every fold
            found[mine] = np.where(count > 0, mean, whole[:, None])
        return self.bounds.normalise(found)


def scatter_of_sum(parts: Array) -> tuple[float, float]:
    """Variance of a sum over contexts of means of their folds or episodes, and how well known.

    Contexts are independent, so that even two episodes of each make the variance of a sum over
    many well known: its degrees of freedom are those of Welch and Satterthwaite,

        (e + 1) (sum_t v_t)^2 / sum_t v_t^2 - 2,

    which is free of the bias that squares of estimated variances have.

    Args:
        parts: (T, e) what each of e >= 2 episodes of a context says of its part of the sum.

    Returns:
        The variance, and degrees of freedom for Student's t; infinite where nothing scatters.
    """
    episodes = parts.shape[1]
    variances = parts.var(axis=1, ddof=1) / episodes
    total = float(variances.sum())
    if total == 0.0:
        return 0.0, np.inf
    shares = variances / total
    return total, max((episodes + 1.0) / float(shares @ shares) - 2.0, 1.0)


def margin_of_sum(parts: Array) -> float:
    """Half a 95 % interval of such a sum; infinite where one episode of each says nothing."""
    if parts.shape[1] == 1:
        return float(np.inf)
    variance, freedom = scatter_of_sum(parts)
    return student(freedom) * float(np.sqrt(variance))


def student(freedom: float) -> float:
    """Half the width of an interval of 95 % in standard errors, by Student's t."""
    from scipy.special import stdtrit  # kept out of `import mbtl`

    return float(stdtrit(min(freedom, _MANY), 0.975))


def checked_returns(
    returns: Any,
    n_targets: int,
    name: Callable[[int], str] | Sequence[Context] = "target {}".format,
    *,
    whole: bool = False,
    gaps: bool = False,
) -> Array:
    """Returns of one evaluation as (n_targets, n_episodes) numbers that can be computed with.

    NaN is an episode that has none.

    Args:
        returns: what an evaluation gave; what a masked array hides is missing.
        n_targets: number of contexts evaluated on.
        name: what a target is called, by its place among them; or the contexts.
        whole: NaN is refused, too.
        gaps: NaN may be everywhere.

    Raises:
        TrainingFailed: wrong shape, NaN everywhere, or a value that is infinite or beyond
            `LARGEST`.
    """
    try:
        array = floats(returns)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:  # the last of tensors
        raise TrainingFailed(
            f"returns must be real numbers, in rows of one length, got {type(returns).__name__} "
            f"({error!s:.90})"
        ) from error
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or array.shape[0] != n_targets or array.shape[1] < 1:
        got = "None; does the function return?" if returns is None else f"{np.shape(returns)}"
        raise TrainingFailed(
            f"returns must have shape ({n_targets},) or ({n_targets}, n_episodes), a row for each "
            f"of the contexts given, got {got}"
        )
    wrong, missing = refused(array), np.isnan(array)
    if array.size and missing.all() and not (whole or gaps):
        raise TrainingFailed(
            "an episode without a return is NaN, but one at least must have one, got NaN in all of "
            f"{array.size}"
        )
    bad = np.argwhere(wrong if whole else wrong & ~missing)
    if len(bad):
        target, episode = bad[0].tolist()
        said = name(target) if callable(name) else str(dict(name[target]))
        raise TrainingFailed(
            f"returns must be finite and within {LARGEST:g}, got "
            f"{float(array[target, episode])!r} for {said}, the first of {len(bad)} of "
            f"{array.size}; give an episode that broke off the worst return there is"
        )
    return array


def completed(returns: Array, *, gaps: bool = False) -> Array:
    """(T, E) returns, where an episode that has none counts as the mean of its context's others.

    These scatter more for it, so that the scatter of all says how sure their mean is.

    Raises:
        TrainingFailed: a context has none at all, and there may be no such `gaps`.
    """
    means, deviations = episode_moments(returns)
    if np.isnan(means).any() and not gaps:
        raise TrainingFailed(
            f"each context needs the return of an episode, got NaN in all of "
            f"{int(np.isnan(means).sum())} of {len(means)} contexts"
        )
    lacking, found = np.isnan(returns), returns.copy()
    for t in np.flatnonzero(lacking.any(axis=1) & ~lacking.all(axis=1)):
        off = np.where(lacking[t], 0.0, returns[t] - means[t])
        scatter = np.sqrt(np.square(off).sum() / max(len(off) - 1, 1))
        found[t] = means[t] + off * (deviations[t] / scatter if scatter > 0.0 else 1.0)
    return found


def episode_moments(returns: Array) -> tuple[Array, Array]:
    """(T,) means and standard deviations of (T, E) returns, of the episodes that have one.

    A mean of m < E episodes is less sure. Its deviation is given sqrt(E / m) times as large, so
    that deviation / sqrt(E) is the standard error of each mean. The deviation is with m - 1, and
    where m = 1 the usual one of the other targets. NaN: no episode has a return, or no deviation
    is known.
    """
    seen = np.isfinite(returns)
    count = seen.sum(axis=1)
    total = np.where(seen, returns, 0.0).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = total / count
        squares = np.square(np.where(seen, returns - means[:, None], 0.0)).sum(axis=1)
        deviations = np.sqrt(squares / (count - 1.0))
        deviations[count < 2] = np.nan
        if np.isfinite(deviations).any():
            deviations[count == 1] = np.nanmedian(deviations)
        return means, deviations * np.sqrt(returns.shape[1] / count)
