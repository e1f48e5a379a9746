"""What a check found: a list of claims, each with its outcome."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from mbtl.errors import CheckFailed

Outcome = Literal["passed", "warning", "failed"]


@dataclass(frozen=True)
class Check:
    """One claim and what came of it.

    Attributes:
        name: the claim, e.g. "axis 'length' acts on the dynamics".
        outcome: "warning" means that it could not be decided, or may be meant.
        detail: what was seen.
    """

    name: str
    outcome: Outcome
    detail: str = ""

    @property
    def ok(self) -> bool:
        """True unless it failed."""
        return self.outcome != "failed"


@dataclass(frozen=True)
class CheckReport:
    """All checks of one CMDP.

    Attributes:
        subject: what was checked.
        checks: in the order in which they ran.
    """

    subject: str
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """True when nothing failed; warnings are allowed."""
        return all(check.ok for check in self.checks)

    @property
    def failures(self) -> list[Check]:
        """The checks that failed."""
        return [check for check in self.checks if not check.ok]

    @property
    def said(self) -> str:
        """How many hold, failed, and could not be decided or may be meant."""
        outcomes = [check.outcome for check in self.checks]
        warnings = outcomes.count("warning")
        parts = [f"{outcomes.count('passed')} of {len(outcomes)} checks hold"]
        parts += [f"{len(self.failures)} failed"] if self.failures else []
        parts += [f"{warnings} warning{'s' * (warnings > 1)}"] if warnings else []
        return ", ".join(parts)

    def raise_if_failed(self) -> None:
        """Do nothing when all is well.

        Raises:
            CheckFailed: naming what failed.
        """
        if self.failures:
            listed = "; ".join(f"{check.name}: {check.detail}" for check in self.failures)
            raise CheckFailed(
                f"{self.subject} failed {len(self.failures)} of {len(self.checks)} checks: {listed}"
            )

    def to_json(self) -> dict[str, Any]:
        """JSON-able record."""
        checks = [{"name": c.name, "outcome": c.outcome, "detail": c.detail} for c in self.checks]
        return {"subject": self.subject, "ok": self.ok, "checks": checks}
