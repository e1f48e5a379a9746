"""Gymnasium ids such as "mbtl/cartpole-length-v0".

Gymnasium 1.0 gave up the entry-point plugins of its predecessors, so ids exist once `mbtl.problems`
has been imported: `gymnasium.make("mbtl.zoo.cmdps:mbtl/cartpole-length-v0")` does both at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gymnasium

from mbtl.zoo.cmdps.families import VARIANTS
from mbtl.zoo.cmdps.registry import cmdp_ids, env_factory, gym_id


def register_envs() -> None:
    """Register the ids of all CMDPs; ids that are registered already are left alone."""
    for id in cmdp_ids():
        if gym_id(id) not in gymnasium.registry:
            # No max_episode_steps: the environments keep their own time limit, see `time_limit`.
            gymnasium.register(gym_id(id), f"{__name__}:make", kwargs={"cmdp": id})


def make(
    cmdp: str,
    context: Mapping[str, Any] | None = None,
    *,
    render_mode: str | None = None,
    gui: bool = False,
    **switches: str,
) -> Any:
    """One environment of a CMDP, for `gymnasium.make`.

    Args:
        cmdp: id of the CMDP.
        context: values of the varied features, within their axes; missing: the nominal ones.
        render_mode: "rgb_array" in traffic and of HalfCheetah: `render` gives images.
        gui: in traffic, show it in sumo-gui.
        **switches: `physics`, `visibility`, `time_limit`, `obs`, `score` as in `get_cmdp`.

    Many decision makers are one environment with a row for each, `mbtl.envs.slots.Together`.
    """
    from mbtl.envs.slots import as_one

    factory = env_factory(cmdp, **switches)
    asked = {"render_mode": render_mode, "gui": gui or None}
    shown = {name: value for name, value in asked.items() if value is not None}
    factory = replace(factory, options={**factory.options, **shown})
    return as_one(factory(VARIANTS[cmdp].nominal if context is None else context))
