"""Strategies that count steps: what to train on, how long, where to evaluate, when to stop."""

from mbtl.actions.base import (
    Action,
    Evaluate,
    Extend,
    Policy,
    Start,
    StartOn,
    StepProblem,
    Stop,
    Strategy,
    Trail,
    Training,
    Wait,
)
from mbtl.actions.committee import Committee
from mbtl.actions.evaluation import Evaluation
from mbtl.actions.fixed import FixedLength
from mbtl.actions.halving import Halving
from mbtl.actions.pilot import Pilot

__all__ = [
    "Action",
    "Committee",
    "Evaluate",
    "Evaluation",
    "Extend",
    "FixedLength",
    "Halving",
    "Pilot",
    "Policy",
    "Start",
    "StartOn",
    "StepProblem",
    "Stop",
    "Strategy",
    "Trail",
    "Training",
    "Wait",
]
