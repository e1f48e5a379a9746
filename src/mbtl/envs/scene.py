"""One environment as a scene: its agents have places (`mbtl.worlds.processes.Scene`).

It is a Gymnasium environment, whose agent has the only place, or a PettingZoo parallel one, whose
agents come and go. What an episode is worth is as in `rollout`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbtl.envs.slots import Seats

Sight = tuple[NDArray[np.float32], NDArray[np.bool_], bool, float]
"""As `mbtl.worlds.processes.Sight`, which needs jax."""
Step = tuple[Sight, NDArray[np.float32], NDArray[np.bool_]]


def scene_of(make_env: Callable[[Mapping[str, float]], Any]) -> SoloScene | TeamScene:
    """A scene whose environments come from context -> environment; it finds out which kind."""
    return _Unknown(make_env)  # type: ignore[return-value]
