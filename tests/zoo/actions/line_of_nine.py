"""Nine contexts on a line and three lengths of training: where strategies are tried."""

import numpy as np

from mbtl.contexts import ContextSpace, Linear
from mbtl.selectors.base import SelectionProblem
from mbtl.zoo.actions import StepProblem

N = 9
SPACE = ContextSpace.grid({Linear("x", 0.0, 8.0): [float(i) for i in range(N)]})
PROBLEM = StepProblem(
    SelectionProblem.of(SPACE, budget=N), np.array([100, 200, 400]), 1e6, episodes=1, horizon=10
)
STEPS = PROBLEM.selection.steps
