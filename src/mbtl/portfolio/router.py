"""Routing one context: what each policy should achieve there, on the list of contexts or off it.

On a listed context beliefs decide (`mbtl.models.beliefs`): what was measured, with its noise
shrunk, or what the transfer model predicts. Elsewhere each policy is judged by the beliefs around:

    grid, one axis    linear interpolation between the grid points around the context (multilinear
                      with more axes; beyond the outermost grid value, that value's return)
    other point list  mean of the 2d nearest listed contexts, weighted by 1 / distance^2 in steps
    nothing around    linear gap model: J(pi_i, x_i) - theta |x - x_i|, distance in grid steps
                      (paper, Assumption 1); for a categorical level that no listed context has

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
from numpy.typing import NDArray

from mbtl.arrays import Array
from mbtl.contexts import Categorical, Context, ContextSpace, Value
from mbtl.errors import ContextMismatch
from mbtl.models.beliefs import Beliefs
from mbtl.routing import SURE, rank

Basis = Literal["observed", "predicted", "interpolated", "gap model"]
Bases = tuple[Basis, ...]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Forecast:
    """What each policy should achieve on one context.

    Attributes:
        performance: (k,) expected.
        basis: (k,) where each number comes from.
        distance: (k,) grid steps from each source.
        target: index of the context, None off the list.
        judged_on: (k, m) listed contexts whose beliefs make each number.
        weights: (m,) theirs, sum 1.
    """

    performance: Array
    basis: Bases
    distance: Array
    target: int | None
    judged_on: Indices
    weights: Array

    def parts(self, policy: int) -> tuple[Indices, Indices, Array]:
        """(m,) rows, contexts and weights of which one policy's number is the weighted sum."""
        return np.full(len(self.weights), policy), self.judged_on[policy], self.weights

    def ranking(self, sources: Sequence[int]) -> list[int]:
        """Policies from best to worst, as `mbtl.routing` ranks them."""
        order = rank(self.performance, self.distance, np.asarray(sources, dtype=np.intp))
        return [int(i) for i in order]


def forecast(
    space: ContextSpace,
    sources: Sequence[int],
    beliefs: Beliefs,
    theta: float,
    context: Mapping[str, Value],
) -> Forecast:
    """Performance of every policy on `context`, and how it is known.

    Raises:
        ContextMismatch: the context lies outside the axes.
    """
    here = space.encode_steps(context)
    distance = np.linalg.norm(space.steps[list(sources)] - here, axis=1)
    target = _listed(space, context)
    if target is not None:
        here_alone = np.full((len(sources), 1), target)
        mean = beliefs.on(np.array([target]))[0][:, 0]
        seen = _seen(beliefs, target)
        return Forecast(mean, seen, distance, target, here_alone, np.ones(1))
    nearby, weights = _neighbours(space, here)
    if len(nearby):
        mean = beliefs.on(nearby)[0] @ weights
        between: list[Basis] = ["interpolated"] * len(sources)
        around = np.tile(nearby, (len(sources), 1))
        return Forecast(mean, tuple(between), distance, None, around, weights)
    trained_on = np.asarray(sources, dtype=np.intp)
    expected = np.diagonal(beliefs.on(trained_on)[0]) - theta * distance
    guessed: list[Basis] = ["gap model"] * len(sources)
    return Forecast(expected, tuple(guessed), distance, None, trained_on[:, None], np.ones(1))


def _seen(beliefs: Beliefs, target: int) -> Bases:
    return tuple("observed" if seen else "predicted" for seen in beliefs.measured[:, target])


def _listed(space: ContextSpace, context: Mapping[str, Value]) -> int | None:
    try:
        return space.index(context)
    except ContextMismatch:  # inside the axes, as `encode_steps` has checked, but not on the list
        return None


def _neighbours(space: ContextSpace, here: Array) -> tuple[Indices, Array]:
    """Listed contexts around a point, and their weights (sum 1)."""
    if space.shape:
        return _cell(space, here)
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


def _cell(space: ContextSpace, here: Array) -> tuple[Indices, Array]:
    """Corners of the grid cell that holds the point, with multilinear weights."""
    assert space.shape is not None
    corners: list[list[tuple[int, float]]] = []  # per axis: (level, weight)
    start = 0
    for axis, n in zip(space.axes, space.shape, strict=True):
        part = here[start : start + axis.width]
        start += axis.width
        if isinstance(axis, Categorical):
            listed = list(dict.fromkeys(space.values(axis.name)))
            value = axis.decode(part[None, :])[0]
            corners.append([(listed.index(value), 1.0)] if value in listed else [])
            continue
        below = min(int(np.floor(part[0])), n - 1)
        share = float(part[0]) - below
        corners.append([(below, 1.0 - share)] + ([(below + 1, share)] if share > 0 else []))
    picks = list(itertools.product(*corners))
    if not picks:  # a categorical level that no listed context has: no neighbours
        return np.empty(0, dtype=np.intp), np.empty(0)
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
        predicted_return: what it should return on the asked context, raw units.
        error: standard error of that, raw units: 1.96 of it are half a 95 % interval. None:
            unknown, because returns are of one episode each, or exact on the listed contexts
            around and nobody knows what is between.
        basis: "observed" (measured there), "predicted" (by the transfer model, from what was
            measured elsewhere), "interpolated" (between the nearest listed contexts) or "gap model"
            (training return less theta per grid step).
        runner_up: position of the second best policy; None when there is none to compare.
        margin: how much better than the runner-up, >= 0, raw units; None without one.
        margin_error: standard error of the margin, raw units, in which luck that policies share
            cancels; None: unknown.
        explanation: the same in one sentence.
    """

    policy: int
    source: int
    source_context: Context
    predicted_return: float
    error: float | None
    basis: Basis
    runner_up: int | None
    margin: float | None
    margin_error: float | None
    explanation: str


def explanation(where: str, choice: Choice, steps: float, alike: bool) -> str:
    """One sentence.

    Args:
        where: what its policy was trained on.
        choice: but for the sentence.
        steps: distance from the source, in grid steps.
        alike: the runner-up was trained at the same distance.
    """
    said = f"{choice.predicted_return:.6g}{_bar(choice.error)}"
    how = {
        "observed": f"returned {said} when it was evaluated here",
        "predicted": f"should return about {said}: it was not evaluated here, the transfer model "
        "predicts it",
        "interpolated": f"should return about {said}, judging by the nearest listed contexts",
        "gap model": f"should return about {said}, its training return less the expected loss over "
        f"{steps:.3g} grid steps",
    }[choice.basis]
    return f"Policy {choice.policy + 1}, trained on {where}, {how}; {_rest(choice, alike)}."


def _bar(error: float | None) -> str:
    if error is None:
        return " (its error is unknown)"
    return f" +- {SURE * error:.3g}" if error else ""


def _rest(choice: Choice, alike: bool) -> str:
    if choice.runner_up is None or choice.margin is None:
        return "no other policy can be compared"
    other = f"policy {choice.runner_up + 1}"
    if choice.margin_error is None:
        if choice.margin == 0.0:
            return f"{other} does as well, as far as is known"
        return f"{other} is {choice.margin:.3g} behind, which may be chance"
    if choice.margin == 0.0:
        nearer = "as near" if alike else "not trained nearer"
        return f"{other} does as well and was {'trained ' if alike else ''}{nearer}"
    if choice.margin < SURE * choice.margin_error:
        return f"{other} may do as well: the difference is within the noise"
    return f"the next best, {other}, is {choice.margin:.3g} behind"
