"""Strategies over trainings of every kind: on one context, several or all; from a policy; how long.

A selector is the strategy that only says on which context to train next, from scratch, whole.
"""

from mbtl.strategies.all_first import AllFirst
from mbtl.strategies.auto import Auto
from mbtl.strategies.one_policy import OnePolicy
from mbtl.strategies.registry import get_strategy, strategy_names

__all__ = ["AllFirst", "Auto", "OnePolicy", "get_strategy", "strategy_names"]
