"""Strategies that count steps: what to train on, how long, where to evaluate, when to stop."""

from mbtl.zoo.actions.base import (
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
from mbtl.zoo.actions.committee import Committee
from mbtl.zoo.actions.evaluation import Evaluation
from mbtl.zoo.actions.fixed import FixedLength
from mbtl.zoo.actions.halving import Halving
from mbtl.zoo.actions.pilot import Pilot

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
