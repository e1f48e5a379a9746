"""The answer of a portfolio to "which policy here, and why?"."""

from __future__ import annotations

from dataclasses import dataclass

from mbtl.contexts import Context
from mbtl.portfolio.router import Basis
from mbtl.routing import SURE


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
