"""What people are shown for reference rows: what goes without a choice of trainings."""

from __future__ import annotations

from collections.abc import Mapping

REFERENCE_NAMES: Mapping[str, str] = {
    "random_actions": "random actions",
    "unguided": "unguided",
    "fixed_time": "fixed time",
    "actuated": "actuated",
    "nominal_policy": "nominal policy",
    "random_policy": "random policy",
}
"""In the order of tables."""
