"""Strategies that count steps: what to train on, how long, where to evaluate, when to stop."""

from mbtl.actions.base import (
    Action,
    Evaluate,
    Extend,
    Policy,
    Start,
    StepProblem,
    Stop,
    Strategy,
    Trail,
    Training,
)
from mbtl.actions.fixed import FixedLength
from mbtl.actions.halving import Halving

__all__ = [
    "Action",
    "Evaluate",
    "Extend",
    "FixedLength",
    "Halving",
    "Policy",
    "Start",
    "StepProblem",
    "Stop",
    "Strategy",
    "Trail",
    "Training",
]
