"""Actions and failures as a log has them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mbtl.actions import Evaluate, Extend, Policy, Start, StartOn
from mbtl.faults import reason_of, traceback_of

Work = Start | StartOn | Extend | Evaluate
"""An action that costs steps."""


def record_of(action: Work) -> dict[str, Any]:
    """An action as JSON; `action_of` reads it back."""
    match action:
        case Start(source, length, start):
            record = {"do": "start", "source": int(source), "length": int(length)}
            return record if start is None else {**record, "start": _record_of_policy(start)}
        case StartOn(sources, length):
            some = [int(s) for s in sources]
            return {"do": "start on", "sources": some, "length": int(length)}
        case Extend(training, length):
            return {"do": "extend", "training": int(training), "length": int(length)}
        case Evaluate(policy, targets):
            some = [int(t) for t in targets]
            return {"do": "evaluate", **_record_of_policy(policy), "targets": some}


def _record_of_policy(policy: Policy) -> dict[str, int]:
    return {"training": int(policy.training), "length": int(policy.length)}


def action_of(record: Mapping[str, Any]) -> Work:
    """What `record_of` wrote."""
    match record["do"]:
        case "start":
            begun = record.get("start")
            start = None if begun is None else Policy(begun["training"], begun["length"])
            return Start(record["source"], record["length"], start)
        case "start on":
            return StartOn(tuple(int(s) for s in record["sources"]), int(record["length"]))
        case "extend":
            return Extend(record["training"], record["length"])
        case "evaluate":
            policy = Policy(record["training"], record["length"])
            return Evaluate(policy, tuple(record["targets"]))
    raise ValueError(f"no action is called {record['do']!r}")


def failure(error: BaseException, steps: float, source: int) -> dict[str, Any]:
    """What went wrong, the steps that it cost, and the context."""
    return {
        "reason": reason_of(error),
        "steps": float(steps),
        "source": source,
        "traceback": traceback_of(error),
    }
