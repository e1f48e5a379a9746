"""Routing one context: what each policy should achieve there, on the list of contexts or off it.

On a listed context beliefs decide (`mbtl.models.beliefs`): what was measured, with its noise
shrunk, or what the transfer model predicts. Elsewhere each policy is judged by the beliefs around:

    grid, one axis    linear interpolation between the grid points around the context (multilinear
                      with more axes; beyond the outermost grid value, that value's return)
    otherwise         mean of the 2d nearest listed contexts, weighted by 1 / distance^2 in steps

Notation (shapes): k policies, N listed contexts.
    sources      (k,)     context index each policy was trained on
    distance     (k,)     Euclidean norm, in grid steps, from each source to the context
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mbtl.arrays import Array, Indices
from mbtl.contexts import Categorical, Context, ContextSpace, Value
from mbtl.errors import ContextMismatch
from mbtl.models.beliefs import Beliefs
from mbtl.routing import SURE

Basis = Literal["observed", "predicted", "interpolated"]


@dataclass(frozen=True, eq=False)
class Forecast:
    """What each policy should achieve on one context.

    Attributes:
        performance: (k,) expected.
        basis: (k,) where each number comes from.
        distance: (k,) grid steps from each source.
        target: index of the context, None off the list.
        judged_on: (m,) listed contexts whose beliefs make each number.
        weights: (m,) theirs, sum 1.
        believed: (k, m) performance there.
    """

    performance: Array
    basis: tuple[Basis, ...]
    distance: Array
    target: int | None
    judged_on: Indices
    weights: Array
    believed: Array

    def between(self, policy: int, less: int | None = None) -> float:
        """Variance of what is between the listed contexts; of a policy, or of its lead.

        As of a number that lies anywhere between those around with the same chance.
        """
        around = self.believed[policy] - (0.0 if less is None else self.believed[less])
        if np.ptp(around) < 1e-9:  # rounding
            return 0.0
        return float(self.weights @ np.square(around - self.weights @ around)) / 3.0


def forecast(
    space: ContextSpace, sources: Sequence[int], beliefs: Beliefs, context: Mapping[str, Value]
) -> Forecast:
    """Performance of every policy on `context`, and how it is known.

    Raises:
        ContextMismatch: the context lies outside the axes.
    """
    here = space.encode_steps(context)
    distance = np.linalg.norm(space.steps[list(sources)] - here, axis=1)
    between: Basis = "interpolated"
    basis = (between,) * len(sources)
    target = _listed(space, context)
    if target is None:
        judged_on, weights = _neighbours(space, here)
    else:
        judged_on, weights = np.array([target]), np.ones(1)
        seen = beliefs.measured[:, target]
        basis = tuple("observed" if there else "predicted" for there in seen)
    believed = beliefs.on(judged_on)[0]
    mean = believed @ weights
    return Forecast(mean, basis, distance, target, judged_on, weights, believed)


def _listed(space: ContextSpace, context: Mapping[str, Value]) -> int | None:
    try:
        return space.index(context)
    except ContextMismatch:  # inside the axes, as `encode_steps` has checked, but not on the list
        return None


def _neighbours(space: ContextSpace, here: Array) -> tuple[Indices, Array]:
    """Listed contexts around a point, and their weights (sum 1)."""
    if space.shape and (corners := _cell(space, here)) is not None:
        return corners
    if space.steps.shape[1] == 1:
        return _bracket(space.steps[:, 0], float(here[0]))
    squared = ((space.steps - here) ** 2).sum(axis=1)
    n = min(2 * space.d, space.n)
    nearby = np.argsort(squared, kind="stable")[:n]
    weights = 1.0 / np.maximum(squared[nearby], 1e-18)
    return nearby, weights / weights.sum()


def _bracket(line: Array, x: float) -> tuple[Indices, Array]:
    order = np.argsort(line, kind="stable")
    position = np.interp(x, line[order], np.arange(len(line)))
    below = int(np.floor(position))
    above = min(below + 1, len(line) - 1)
    share = position - below
    return order[[below, above]], np.array([1.0 - share, share])


def _cell(space: ContextSpace, here: Array) -> tuple[Indices, Array] | None:
    """Corners of the grid cell that holds the point, with multilinear weights.

    None where it has a categorical level that no listed context has.
    """
    assert space.shape is not None
    corners: list[list[tuple[int, float]]] = []  # per axis: (level, weight)
    start = 0
    for axis, n in zip(space.axes, space.shape, strict=True):
        part = here[start : start + axis.width]
        start += axis.width
        if isinstance(axis, Categorical):
            listed = list(dict.fromkeys(space.values(axis.name)))
            value = axis.choices[int(part.argmax())]
            if value not in listed:
                return None
            corners.append([(listed.index(value), 1.0)])
            continue
        below = min(int(np.floor(part[0])), n - 1)
        share = float(part[0]) - below
        corners.append([(below, 1.0 - share)] + ([(below + 1, share)] if share > 0 else []))
    picks = list(itertools.product(*corners))
    levels = np.array([[level for level, _ in pick] for pick in picks]).T
    weights = np.array([float(np.prod([w for _, w in pick])) for pick in picks])
    return np.ravel_multi_index(tuple(levels), space.shape), weights


# ---- the answer to: which policy here, and why? --------------------------------------------------


@dataclass(frozen=True)
class Choice:
    """Which policy serves a context, and why.

    Attributes:
        policy: position in the portfolio, 0..k-1; people count from 1.
        source: index of the context it was trained on; of several, the one in their middle.
        source_context: that context.
        trained_on: what it was trained on, in words.
        predicted_return: what it should return on the asked context, raw units.
        error: standard error of that, raw units: 1.96 of it are half a 95 % interval. None:
            unknown, because returns are of one episode each, or exact and the same on the listed
            contexts around. Between these it has how much they differ, too.
        basis: "observed" (measured there), "predicted" (by the transfer model, from what was
            measured elsewhere) or "interpolated" (between the nearest listed contexts).
        runner_up: position of the second best policy; None when there is none to compare.
        margin: how much better than the runner-up, >= 0, raw units; None without one.
        margin_error: standard error of the margin, raw units, in which luck that policies share
            cancels; None: unknown.
        instead: where the asked context lies outside: the nearest one inside, on which all of this
            is.
    """

    policy: int
    source: int
    source_context: Context
    trained_on: str
    predicted_return: float
    error: float | None
    basis: Basis
    runner_up: int | None
    margin: float | None
    margin_error: float | None
    instead: Context | None = None

    @property
    def explanation(self) -> str:
        """The same in one sentence."""
        said = f"{self.predicted_return:.6g}{_bar(self.error)}"
        how = {
            "observed": f"should return about {said}: it was evaluated here",
            "predicted": f"should return about {said}: it was not evaluated here, the transfer "
            "model predicts it",
            "interpolated": f"should return about {said}, judging by the nearest listed contexts",
        }[self.basis]
        text = f"Policy {self.policy + 1}, trained on {self.trained_on}, {how}; {self._rest}."
        if self.instead is None:
            return text
        where = ", ".join(f"{name} = {value}" for name, value in self.instead.items())
        return f"Outside of the contexts, judged at the nearest one inside, {where}: {text}"

    @property
    def _rest(self) -> str:
        """How far the runner-up is behind."""
        if self.runner_up is None or self.margin is None:
            return "no other policy can be compared"
        other = f"policy {self.runner_up + 1}"
        if self.margin_error is None:
            if self.margin == 0.0:
                return f"{other} does as well, as far as is known"
            return f"{other} is {self.margin:.3g} behind, which may be chance"
        if self.margin == 0.0:
            return f"{other} does as well and was not trained nearer"
        if self.margin < SURE * self.margin_error:
            return f"{other} may do as well: the difference is within the noise"
        return f"the next best, {other}, is {self.margin:.3g} behind"


def _bar(error: float | None) -> str:
    if error is None:
        return " (its error is unknown)"
    return f" +- {SURE * error:.3g}" if error else ""
