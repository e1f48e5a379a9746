"""The locomotion part of the table of our CMDPs (cmdp-spec, sections 2, 4.3, 4.4 and 10).

Native simulators step whole batches for the engine. Nothing here imports an environment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mbtl.cmdps.cmdp import Preset
from mbtl.cmdps.family import Family, GridAxis, JaxFamily, Variant, line

_CHEETAH: Mapping[str, Any] = {
    "n_envs": 64,
    "n_steps": 32,
    "batch_size": 256,
    "n_epochs": 8,
    "learning_rate": 7e-4,
    "gamma": 0.98,
    "gae_lambda": 0.92,
    "log_std": -1.0,
    "standardize": True,
}
"""Many copies, since MuJoCo steps all of them in one call, and numbers of one size: speeds are a
hundred times as large as angles."""

_WALKER: Mapping[str, Any] = {
    "n_envs": 32,
    "n_steps": 128,
    "batch_size": 256,
    "n_epochs": 4,
    "learning_rate": 1e-3,
}


def _ours(hyperparameters: Mapping[str, Any]) -> dict[str, Preset]:
    standard = Preset(
        budget=15,
        timesteps=1_000_000,
        eval_episodes=10,
        algorithm="PPO",
        recipe_name="fast",
        hyperparameters=hyperparameters,
        checkpoint="best",
        checkpoint_every=50_000,
        checkpoint_episodes=4,
        description="a fifth of the paper's steps with our faster recipe, "
        "best-of-evaluations policy",
    )
    return {
        "standard": standard,
        "quick": replace(
            standard,
            budget=10,
            timesteps=200_000,
            eval_episodes=4,
            checkpoint_every=20_000,
            description="a first look with our faster recipe, best-of-evaluations policy",
        ),
        "paper": replace(
            standard,
            timesteps=5_000_000,
            eval_episodes=100,
            recipe_name="sb3",
            hyperparameters=None,
            checkpoint_every=100_000,
            checkpoint_episodes=10,
            description="the paper's steps and hyper-parameters (SB3's default PPO), "
            "best-of-evaluations policy: several times slower than `standard` at equal steps",
        ),
    }


_SB3 = {
    "standard": Preset(
        budget=15,
        timesteps=1_000_000,
        eval_episodes=10,
        algorithm="PPO",
        checkpoint="best",
        checkpoint_episodes=4,
        description="a fifth of the paper's steps: SB3 default PPO, best-of-evaluations policy",
    ),
    "paper": Preset(
        budget=15,
        timesteps=5_000_000,
        eval_episodes=100,
        algorithm="PPO",
        checkpoint="best",
        checkpoint_episodes=10,
        description="the paper's budget: SB3 default PPO, best-of-evaluations policy",
    ),
}

LOCOMOTION_FAMILIES: Mapping[str, Family] = {
    "walker": Family(
        entry_point="mbtl.cmdps.locomotion.walker:BipedalWalker",
        horizon=1000,
        bounds=(-150.0, 300.0),
        paper_bounds=(-200.0, 10.0),
        theta=0.005,
        presets=_SB3,
        preset_on_all="standard",
        jax=JaxFamily("mbtl.worlds.walker:BipedalWalker", _ours(_WALKER)),
    ),
    "cheetah": Family(
        entry_point="mbtl.cmdps.locomotion.cheetah:HalfCheetah",
        horizon=1000,
        bounds=(0.0, 6000.0),
        paper_bounds=(0.0, 6000.0),
        theta=0.005,
        presets=_SB3,
        preset_on_all="standard",
        jax=JaxFamily(
            "mbtl.cmdps.locomotion.cheetah_batch:HalfCheetahs", _ours(_CHEETAH), on_host=True
        ),
    ),
}

_PER_SCALE = "px/m"
"""Unit of the walker's scale: the hull is drawn in pixels."""

LOCOMOTION_VARIANTS: Mapping[str, Variant] = {
    "walker-gravity": line(
        "walker",
        "gravity",
        "m/s^2",
        "0.2",
        10.0,
        paper_step="1",
        version=2,
        description="BipedalWalker; gravity varies",
    ),
    "walker-friction": line(
        "walker",
        "friction",
        "1",
        "0.1",
        2.5,
        paper_step="0.25",
        version=2,
        description="BipedalWalker; the friction of the ground varies",
    ),
    "walker-scale": line(
        "walker",
        "scale",
        _PER_SCALE,
        "1",
        30.0,
        paper_step="3",
        version=2,
        description="BipedalWalker; the scale varies, by which hull and roughness are divided",
    ),
    "walker-512": Variant(
        "walker",
        (
            GridAxis("gravity", "m/s^2", "2", 10.0, n=8, unit_index=4),
            GridAxis("friction", "1", "0.5", 2.5, n=8, unit_index=4),
            GridAxis("scale", _PER_SCALE, "6", 30.0, n=8, unit_index=4),
        ),
        theta=0.01,  # a step is two of the steps on one axis, in multiples of the nominal value
        version=2,
        description="BipedalWalker; gravity, friction and scale vary (SD-MBTL's 512)",
    ),
    "cheetah-gravity": line(
        "cheetah",
        "gravity",
        "m/s^2",
        "0.981",
        9.81,
        paper_step="0.98",
        description="HalfCheetah; gravity varies",
    ),
    "cheetah-friction": line(
        "cheetah",
        "friction",
        "1",
        "0.04",
        0.4,
        paper_step="0.06",
        description="HalfCheetah; sliding friction varies",
    ),
    "cheetah-stiffness": line(
        "cheetah",
        "stiffness",
        "1",
        "0.1",
        1.0,
        description="HalfCheetah; the stiffness of all driven joints varies, as a factor",
    ),
}
