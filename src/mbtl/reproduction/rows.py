"""A verdict on each line of the paper's tables, with the reason, computed from the numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mbtl.reproduction.claims import NOT, OPEN, PARTLY, REPRODUCED
from mbtl.reproduction.paper import HEADS

NEAR = 0.05
"""Difference of V at which two values count as the same level."""

RULE = (
    "Three checks. Level: each of the six values that is there is within 0.05 of the paper's. "
    "Order: several policies (mean of Random, Greedy and MBTL) are above the better of Independent "
    "and Multi-task exactly where they are in the paper. Best: MBTL is among the best (standard "
    "errors overlap) exactly where it is in the paper. Three checks: reproduced; one or two: "
    "partly; none: not."
)
_SIX = ("independent", "multitask", "random", "greedy", "mbtl", "sequential_oracle")
_SEVERAL = ("random", "greedy", "mbtl")


@dataclass(frozen=True)
class RowVerdict:
    """One CMDP.

    Attributes:
        cmdp: its id.
        verdict: as in `mbtl.reproduction.claims`.
        checks: name -> passed; empty where there is no matrix.
        reason: in a sentence or two.
    """

    cmdp: str
    verdict: str
    checks: dict[str, bool]
    reason: str


def row_verdict(row: dict[str, Any]) -> RowVerdict:
    """The verdict on a line of item 1's numbers."""
    ours, paper = row["ours"], row["published"]
    if ours is None or paper is None:
        reason = "no matrix yet" if ours is None else "not in the paper"
        return RowVerdict(row["cmdp"], OPEN, {}, reason)
    away = {m: ours[m]["mean"] - paper[m]["mean"] for m in _SIX if m in ours}
    off = {m: d for m, d in away.items() if abs(d) > NEAR}
    checks = {
        "level": not off,
        "order": _several_pay(ours) == _several_pay(paper),
        "best": ("mbtl" in row["marked"]) == ("mbtl" in row["published_marked"]),
    }
    passed = sum(checks.values())
    verdict = REPRODUCED if passed == len(checks) else PARTLY if passed else NOT
    return RowVerdict(row["cmdp"], verdict, checks, " ".join(_reasons(row, checks, off)))


def _single(values: dict[str, Any]) -> float:
    return max(float(values[m]["mean"]) for m in ("independent", "multitask") if m in values)


def _several_pay(values: dict[str, Any]) -> bool:
    there = [float(values[m]["mean"]) for m in _SEVERAL if m in values]
    return sum(there) / len(there) > _single(values)


def _reasons(row: dict[str, Any], checks: dict[str, bool], off: dict[str, float]) -> list[str]:
    ours, found = row["ours"], []
    if off:
        words = ", ".join(f"{HEADS[m]} {d:+.2f}" for m, d in off.items())
        found.append(f"Away from the paper: {words}.")
    if off.get("independent", 0.0) > 0:
        found.append("Policies are better on their own context than the paper's, so less is left "
                     "to gain.")  # fmt: skip
    if off.get("independent", 0.0) < 0:
        found.append("Policies are worse on their own context than the paper's.")
    if off.get("multitask", 0.0) > 0:
        found.append("One policy for all contexts is a stronger baseline here.")
    if not checks["order"]:
        side = "above" if _several_pay(ours) else "not above"
        found.append(f"Several policies are {side} the single-policy baselines, unlike there.")
    if not checks["best"]:
        side = "is" if "mbtl" in row["marked"] else "is not"
        found.append(f"MBTL {side} among the best, unlike there.")
    room = float(ours["sequential_oracle"]["mean"]) - float(ours["random"]["mean"])
    if room < 0.01:
        found.append(f"The oracle is only {room:.4f} above Random: there is little to choose.")
    unguided = row["references"].get("unguided")
    if unguided and unguided["mean"] > ours["mbtl"]["mean"]:
        found.append(
            f"Without a controller V is {unguided['mean']:.3f}, more than MBTL's policies have."
        )
    return found or ["All checks pass."]
