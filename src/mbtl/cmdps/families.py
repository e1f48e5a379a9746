"""The table of our CMDPs: simulator families and what varies in each (cmdp-spec, sections 2 and 4).

A new CMDP is one `Variant`; a new simulator is one `Family` and a module with its environment.
Traffic is in `traffic_families`, robots are in `locomotion_families`. Nothing here imports an
environment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mbtl.cmdps.cmdp import Preset
from mbtl.cmdps.family import Family, GridAxis, JaxFamily, Variant, line
from mbtl.cmdps.locomotion_families import LOCOMOTION_FAMILIES, LOCOMOTION_VARIANTS
from mbtl.cmdps.traffic_families import TRAFFIC_FAMILIES, TRAFFIC_VARIANTS


def _paper(timesteps: int) -> Preset:
    return Preset(
        budget=15,
        timesteps=timesteps,
        eval_episodes=100,
        algorithm="PPO",
        checkpoint="best",
        checkpoint_episodes=10,
        description="the paper's budget: SB3 default PPO, best-of-evaluations policy",
    )


_CARTPOLE = {
    "quick": Preset(
        budget=10,
        timesteps=40_000,
        eval_episodes=10,
        algorithm="PPO",
        checkpoint="final",
        description="minutes on a laptop: SB3 default PPO, final policy",
    ),
    "paper": _paper(5_000_000),
}

_PENDULUM_PPO = {"learning_rate": 1e-3, "gamma": 0.9, "n_steps": 1024}
"""SB3's default PPO needs about a million steps here; these need about a tenth."""

_PENDULUM = {
    "quick": Preset(
        budget=10,
        timesteps=100_000,
        eval_episodes=10,
        algorithm="PPO",
        hyperparameters=_PENDULUM_PPO,
        checkpoint="final",
        n_envs=4,
        description="minutes on a laptop: PPO tuned for short training, final policy",
    ),
    "paper": _paper(1_000_000),
}


def _jax(
    environment: str, paper_steps: int, hyperparameters: Mapping[str, Any] | None = None
) -> JaxFamily:
    """The paper's steps are the default here: a policy takes seconds."""
    full = Preset(
        budget=15,
        timesteps=paper_steps,
        eval_episodes=100,
        algorithm="PPO",
        recipe_name="fast",
        hyperparameters=hyperparameters,
        checkpoint="best",
        checkpoint_episodes=10,
        description="the paper's steps with our faster recipe, best-of-evaluations policy",
    )
    return JaxFamily(
        environment,
        {
            "full": full,
            "quick": replace(
                full,
                budget=10,
                timesteps=100_000,
                eval_episodes=10,
                description="a first look with our faster recipe, best-of-evaluations policy",
            ),
            "paper": replace(
                full,
                recipe_name="sb3",
                hyperparameters=None,
                description="the paper's steps and hyper-parameters (SB3's default PPO), "
                "best-of-evaluations policy: several times slower than `full`",
            ),
        },
    )


_PENDULUM_JAX = {
    "n_envs": 4,
    "n_steps": 512,
    "n_epochs": 2,
    "learning_rate": 1e-3,
    "gamma": 0.95,
    "max_grad_norm": 5.0,
}
"""As good as SB3's default PPO after a million steps; one pass over shorter rollouts is not."""


FAMILIES: Mapping[str, Family] = {
    "cartpole": Family(
        entry_point="mbtl.cmdps.cartpole:CartPole",
        horizon=500,
        bounds=(0.0, 500.0),
        best_return=500.0,
        theta=0.005,
        presets=_CARTPOLE,
        jax=_jax("mbtl.worlds:CartPole", 5_000_000, {"gamma": 0.99}),
        switches=("physics",),
    ),
    "pendulum": Family(
        entry_point="mbtl.cmdps.pendulum:Pendulum",
        horizon=200,
        bounds=(-2200.0, -500.0),
        theta=0.005,
        presets=_PENDULUM,
        jax=_jax("mbtl.worlds:Pendulum", 1_000_000, _PENDULUM_JAX),
    ),
    **LOCOMOTION_FAMILIES,
    **TRAFFIC_FAMILIES,
}


VARIANTS: Mapping[str, Variant] = {
    "cartpole-masscart": line(
        "cartpole", "masscart", "kg", "0.1", 1.0, description="CartPole; the cart mass varies"
    ),
    "cartpole-length": line(
        "cartpole",
        "length",
        "m",
        "0.05",
        0.5,
        description="CartPole; half the pole's length varies",
    ),
    "cartpole-masspole": line(
        "cartpole", "masspole", "kg", "0.01", 0.1, description="CartPole; the pole mass varies"
    ),
    "cartpole-masses-length": Variant(
        "cartpole",
        (
            GridAxis("masspole", "kg", "0.02", 0.1, n=10, unit_index=4),
            GridAxis("masscart", "kg", "0.2", 1.0, n=10, unit_index=4),
            GridAxis("length", "m", "0.1", 0.5, n=9, first=2, unit_index=3),
        ),
        theta=0.01,  # a step is two of the steps on one axis, in multiples of the nominal value
        description="CartPole; both masses and half the pole's length vary (SD-MBTL's 900)",
    ),
    "pendulum-length": line(
        "pendulum", "length", "m", "0.1", 1.0, description="Pendulum; the length varies"
    ),
    "pendulum-mass": line(
        "pendulum", "mass", "kg", "0.1", 1.0, description="Pendulum; the mass varies"
    ),
    "pendulum-timestep": line(
        "pendulum",
        "timestep",
        "s",
        "0.005",
        0.05,
        description="Pendulum; the time between two actions varies",
    ),
    **LOCOMOTION_VARIANTS,
    **TRAFFIC_VARIANTS,
}
