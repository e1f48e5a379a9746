"""Gymnasium ids such as "mbtl/cartpole-length-v0".

Gymnasium 1.0 gave up the entry-point plugins of its predecessors, so ids exist once `mbtl.cmdps`
has been imported: `gymnasium.make("mbtl.cmdps:mbtl/cartpole-length-v0")` does both at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium

from mbtl.cmdps.families import VARIANTS
from mbtl.cmdps.registry import cmdp_ids, env_factory, gym_id


def register_envs() -> None:
    """Register the ids of all CMDPs; ids that are registered already are left alone."""
    for id in cmdp_ids():
        if gym_id(id) not in gymnasium.registry:
            # No max_episode_steps: the environments keep their own time limit, see `time_limit`.
            gymnasium.register(gym_id(id), f"{__name__}:make", kwargs={"cmdp": id})


def make(cmdp: str, context: Mapping[str, Any] | None = None, **switches: str) -> Any:
    """One environment of a CMDP, for `gymnasium.make`.

    Args:
        cmdp: id of the CMDP.
        context: value of the varied feature; missing: the nominal one.
        **switches: `physics`, `visibility`, `time_limit` as in `mbtl.cmdps.get_cmdp`.
    """
    variant = VARIANTS[cmdp]
    nominal = {variant.axis: variant.nominal}
    return env_factory(cmdp, **switches)(nominal if context is None else context)
