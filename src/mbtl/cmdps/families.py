"""The table of our CMDPs: simulator families and what varies in each (cmdp-spec, sections 2 and 4).

A new CMDP is one `Variant`; a new simulator is one `Family` and a module with its environment.
Nothing here imports an environment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

from mbtl.cmdps.cmdp import Preset


@dataclass(frozen=True)
class JaxFamily:
    """A family in the jax engine.

    Attributes:
        environment: name of the class in `mbtl.training.jax`.
        presets: recipes by name, the first is the default.
    """

    environment: str
    presets: Mapping[str, Preset]


@dataclass(frozen=True)
class TwinFamily:
    """A traffic family that has a twin in the jax engine.

    Attributes:
        problem: "module:Class" of a record that maps contexts to twin and parameters.
        presets: recipes by name, the first is the default.
        options: of the record.
    """

    problem: str
    presets: Mapping[str, Preset]
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Family:
    """What the CMDPs of one simulator share.

    Attributes:
        entry_point: "module:Class" of the environment.
        horizon: longest episode, environment steps.
        bounds: returns at which performance is 0 and 1 (spec, 2.2).
        theta: slope of the linear gap, performance per grid step (spec, 2.2).
        presets: recipes of Stable-Baselines3 by name, the first is the default.
        jax: the same in the jax engine, if it is there.
        switches: options of the environment beside visibility and time limit.
        simulator: the engine of `entry_point`, "gymnasium" or "sumo".
        visibility: what of the context the policy sees unless told otherwise.
    """

    entry_point: str
    horizon: int
    bounds: tuple[float, float]
    theta: float
    presets: Mapping[str, Preset]
    jax: JaxFamily | TwinFamily | None = None
    switches: tuple[str, ...] = ()
    simulator: str = "gymnasium"
    visibility: str = "multiplier"


@dataclass(frozen=True)
class Variant:
    """One CMDP: the axis that varies.

    Attributes:
        family: name of the family.
        axis: feature of the environment that varies.
        axis_unit: its physical unit.
        step: grid step, a decimal; the grid is step, 2 step, ..., N step.
        nominal: value of the axis while another one varies.
        n: number of contexts N.
        unit_index: grid index of multiplier 1, not the middle.
        paper_step: grid step by the paper's text where it differs from the released scripts.
        version: raised when results could change.
        description: one line for people.
    """

    family: str
    axis: str
    axis_unit: str
    step: str
    nominal: float
    n: int = 100
    unit_index: int = 9
    paper_step: str | None = None
    version: int = 0
    description: str = ""

    def values(self, grid: str) -> list[float]:
        """(N,) grid values; exact decimals, so that contexts print as they are meant."""
        step = Decimal(self.paper_step or self.step) if grid == "paper" else Decimal(self.step)
        return [float(step * k) for k in range(1, self.n + 1)]


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
    "standard": Preset(
        budget=15,
        timesteps=300_000,
        eval_episodes=20,
        algorithm="PPO",
        checkpoint="best",
        checkpoint_episodes=10,
        description="an hour or two: SB3 default PPO, best-of-evaluations policy",
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
    "standard": Preset(
        budget=15,
        timesteps=300_000,
        eval_episodes=20,
        algorithm="PPO",
        hyperparameters=_PENDULUM_PPO,
        checkpoint="best",
        checkpoint_episodes=10,
        n_envs=4,
        description="an hour or two: PPO tuned for short training, best-of-evaluations policy",
    ),
    "paper": _paper(1_000_000),
}


def _jax(
    environment: str, paper_steps: int, hyperparameters: Mapping[str, Any] | None = None
) -> JaxFamily:
    """The paper's steps are the default here: a policy takes seconds."""

    def preset(timesteps: int, eval_episodes: int, budget: int, description: str) -> Preset:
        return Preset(
            budget=budget,
            timesteps=timesteps,
            eval_episodes=eval_episodes,
            algorithm="PPO",
            recipe_name="fast",
            hyperparameters=hyperparameters,
            checkpoint="best",
            checkpoint_episodes=10,
            description=description,
        )

    return JaxFamily(
        environment,
        {
            "paper": preset(paper_steps, 100, 15, "the paper's steps, best-of-evaluations policy"),
            "standard": preset(300_000, 20, 15, "fewer steps, best-of-evaluations policy"),
            "quick": preset(100_000, 10, 10, "a first look, best-of-evaluations policy"),
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


def _advisory(episodes: int, budget: int, eval_episodes: int, description: str) -> Preset:
    return Preset(
        budget=budget,
        episodes=episodes,
        eval_episodes=eval_episodes,
        algorithm="TRPO",
        checkpoint="best",
        checkpoint_episodes=10,
        description=description,
    )


def _sumo_trpo(episodes: int, budget: int, eval_episodes: int, description: str) -> Preset:
    """As near to cmdp-spec, 7.4, as sb3-contrib's TRPO comes; an update is one episode long."""
    return Preset(
        budget=budget,
        episodes=episodes,
        eval_episodes=eval_episodes,
        algorithm="TRPO",
        hyperparameters={
            "n_steps": "episode",
            "batch_size": 400,
            "gamma": 0.999,
            "gae_lambda": 1.0,
            "learning_rate": 1e-4,
            "n_critic_updates": 1,
            "cg_max_steps": 10,
            "cg_damping": 0.1,
            "line_search_shrinking_factor": 0.5,
            "line_search_max_iter": 10,
            "target_kl": 0.01,
        },
        acting="sampled",
        normalize_reward=True,
        checkpoint="best",
        checkpoint_episodes=10,
        description=description,
    )


_TWIN_PRESETS = {
    "paper": _advisory(1000, 15, 50, "the paper's episodes, best-of-evaluations policy"),
    "quick": _advisory(100, 10, 10, "a first look, best-of-evaluations policy"),
}

_SUMO_TRPO = {
    "paper": _sumo_trpo(1000, 15, 50, "the paper's episodes in SUMO, hours per policy and core"),
    "quick": _sumo_trpo(100, 10, 5, "a first look in SUMO"),
}


def _ring(actions: str) -> Family:
    name = {"acceleration": "RingAcc", "speed": "RingVel"}[actions]
    return Family(
        entry_point=f"mbtl.cmdps.traffic.ring:{name}",
        horizon=400,
        bounds=(0.0, 4.5),
        theta=0.005,
        presets=_SUMO_TRPO,
        jax=TwinFamily("mbtl.cmdps.traffic.twins:RingProblem", _TWIN_PRESETS, {"actions": actions}),
        switches=("obs",),
        simulator="sumo",
        visibility="hidden",
    )


FAMILIES: Mapping[str, Family] = {
    "cartpole": Family(
        entry_point="mbtl.cmdps.cartpole:CartPole",
        horizon=500,
        bounds=(0.0, 500.0),
        theta=0.005,
        presets=_CARTPOLE,
        jax=_jax("CartPole", 5_000_000, {"gamma": 0.99}),
        switches=("physics",),
    ),
    "pendulum": Family(
        entry_point="mbtl.cmdps.pendulum:Pendulum",
        horizon=200,
        bounds=(-2200.0, -500.0),
        theta=0.005,
        presets=_PENDULUM,
        jax=_jax("Pendulum", 1_000_000, _PENDULUM_JAX),
    ),
    "ring-acc": _ring("acceleration"),
    "ring-vel": _ring("speed"),
}


def _hold(family: str, description: str) -> Variant:
    return Variant(family, "hold", "s", "1", 1.0, n=40, unit_index=0, description=description)


VARIANTS: Mapping[str, Variant] = {
    "cartpole-masscart": Variant(
        "cartpole", "masscart", "kg", "0.1", 1.0, description="CartPole; the cart mass varies"
    ),
    "cartpole-length": Variant(
        "cartpole",
        "length",
        "m",
        "0.05",
        0.5,
        description="CartPole; half the pole's length varies",
    ),
    "cartpole-masspole": Variant(
        "cartpole", "masspole", "kg", "0.01", 0.1, description="CartPole; the pole mass varies"
    ),
    "pendulum-length": Variant(
        "pendulum", "length", "m", "0.1", 1.0, description="Pendulum; the length varies"
    ),
    "pendulum-mass": Variant(
        "pendulum", "mass", "kg", "0.1", 1.0, description="Pendulum; the mass varies"
    ),
    "pendulum-timestep": Variant(
        "pendulum",
        "timestep",
        "s",
        "0.005",
        0.05,
        description="Pendulum; the time between two actions varies",
    ),
    "ring-acc": _hold("ring-acc", "Ring road, accelerations advised; the hold varies"),
    "ring-vel": _hold("ring-vel", "Ring road, speeds advised; the hold varies"),
}
