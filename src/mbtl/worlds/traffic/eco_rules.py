"""Hand-written rules of eco-driving as networks, so that a training can begin with one.

    glide   arrive at the light when it turns green, slowly first; see docs/eco-driving.md

The files hold layers of tanh that `evidence/eco_clone.py` has fitted to the rule; they see the
39 numbers of an agent and advise a speed as a share of the limit.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbtl.errors import unknown_name

Layers = tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]

RULES = ("glide",)
FOLDER = Path(__file__).parent / "rules"


@cache
def layers(name: str) -> Layers:
    """Weights (n_in, n_out) and biases of each layer.

    Raises:
        UnknownName: there is no such rule.
    """
    if name not in RULES:
        raise unknown_name("rule of eco-driving", name, RULES)
    with np.load(FOLDER / f"{name}.npz", allow_pickle=False) as file:
        return tuple((file[f"weight_{k}"], file[f"bias_{k}"]) for k in range(len(file.files) // 2))
