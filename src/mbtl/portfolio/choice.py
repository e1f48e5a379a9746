"""The answer of a portfolio to "which policy here, and why?"."""

from __future__ import annotations

from dataclasses import dataclass

from mbtl.contexts import Context, ContextSpace
from mbtl.portfolio.router import Basis


@dataclass(frozen=True)
class Choice:
    """Which policy serves a context, and why.

    Attributes:
        policy: position in the portfolio, 0..k-1.
        source: index of the context it was trained on.
        source_context: that context.
        predicted_return: what it should return on the asked context, raw units.
        basis: "observed" (measured there), "interpolated" (from its returns on the nearest listed
            contexts) or "gap model" (training return less theta per grid step).
        runner_up: position of the second best policy; None when there is none to compare.
        margin: how much better than the runner-up, >= 0, raw units; None without one.
        explanation: the same in one sentence.
    """

    policy: int
    source: int
    source_context: Context
    predicted_return: float
    basis: Basis
    runner_up: int | None
    margin: float | None
    explanation: str


def explanation(
    space: ContextSpace,
    policy: int,
    source: int,
    predicted: float,
    basis: Basis,
    steps: float,
    runner_up: int | None,
    margin: float | None,
) -> str:
    """One sentence; `steps` is the distance from the source in grid steps."""
    how = {
        "observed": f"returned {predicted:.6g} when it was evaluated here",
        "interpolated": f"should return about {predicted:.6g}, judging by its returns on the "
        "nearest evaluated contexts",
        "gap model": f"should return about {predicted:.6g}, its training return less the expected "
        f"loss over {steps:.3g} grid steps",
    }[basis]
    if runner_up is None:
        rest = "no other policy can be compared"
    elif margin == 0.0:
        rest = f"policy {runner_up} does as well but was not trained nearer"
    else:
        rest = f"the next best, policy {runner_up}, is {margin:.3g} behind"
    return f"Policy {policy}, trained on {space.describe(space.context(source))}, {how}; {rest}."
