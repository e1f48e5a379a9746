"""A claim of the paper, and the words of a verdict on it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

REPRODUCED, PARTLY, NOT, OPEN = "reproduced", "partly", "not reproduced", "not testable"


@dataclass(frozen=True)
class Claim:
    """One claim.

    Attributes:
        title: in a few words.
        paper: what the paper says.
        rule: when it counts as reproduced, and when as partly.
        found: what was found, with numbers.
        verdict: "reproduced", "partly", "not reproduced" or "not testable".
        figure: stem of the figure to look at; empty if there is none.
    """

    title: str
    paper: str
    rule: str
    found: str
    verdict: str
    figure: str = ""

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        return asdict(self)


def verdict(full: bool, part: bool) -> str:
    """Of a claim that can be tested."""
    return REPRODUCED if full else PARTLY if part else NOT
