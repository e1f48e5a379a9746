"""The table of our CMDPs: simulator families and what varies in each (cmdp-spec, sections 2 and 4).

A new CMDP is one `Variant`; a new simulator is one `Family` and a module with its environment.
Nothing here imports an environment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mbtl.problems.cmdp import Preset
from mbtl.score import Score
from mbtl.zoo.cmdps.family import Family, GridAxis, JaxFamily, TwinFamily, Variant, line

# ---- the locomotion part of the table of our CMDPs (cmdp-spec, sections 2, 4.3, 4.4 and 10) --
#
# Native simulators step whole batches for the engine. Nothing here imports an environment.


_CHEETAH: Mapping[str, Any] = {
    "n_envs": 64, "n_steps": 32, "batch_size": 256, "n_epochs": 8, "learning_rate": 7e-4,
    "gamma": 0.98, "gae_lambda": 0.92, "log_std": -1.0, "standardize": True,
}  # fmt: skip
"""Many copies, since MuJoCo steps all of them in one call, and numbers of one size: speeds are a
hundred times as large as angles."""

_WALKER: Mapping[str, Any] = {
    "n_envs": 32, "n_steps": 128, "batch_size": 256, "n_epochs": 4, "learning_rate": 1e-3,
}  # fmt: skip


def _ours(hyperparameters: Mapping[str, Any]) -> dict[str, Preset]:
    standard = Preset(
        budget=15, timesteps=1_000_000, eval_episodes=10, algorithm="PPO", recipe_name="fast",
        hyperparameters=hyperparameters, checkpoint="best", checkpoint_every=50_000,
        checkpoint_episodes=4,
        description="a fifth of the paper's steps with our faster recipe, "
        "best-of-evaluations policy",
    )  # fmt: skip
    return {
        "standard": standard,
        "quick": replace(
            standard, budget=10, timesteps=200_000, eval_episodes=4, checkpoint_every=20_000,
            description="a first look with our faster recipe, best-of-evaluations policy",
        ),
        "paper": replace(
            standard, timesteps=5_000_000, eval_episodes=100, recipe_name="sb3",
            hyperparameters=None, checkpoint_every=100_000, checkpoint_episodes=10,
            description="the paper's steps and hyper-parameters (SB3's default PPO), "
            "best-of-evaluations policy: several times slower than `standard` at equal steps",
        ),
    }  # fmt: skip


_SB3 = {
    "standard": Preset(
        budget=15, timesteps=1_000_000, eval_episodes=10, algorithm="PPO", checkpoint="best",
        checkpoint_episodes=4,
        description="a fifth of the paper's steps: SB3 default PPO, best-of-evaluations policy",
    ),
    "paper": Preset(
        budget=15, timesteps=5_000_000, eval_episodes=100, algorithm="PPO", checkpoint="best",
        checkpoint_episodes=10,
        description="the paper's budget: SB3 default PPO, best-of-evaluations policy",
    ),
}  # fmt: skip

LOCOMOTION_FAMILIES: Mapping[str, Family] = {
    "walker": Family(
        entry_point="mbtl.zoo.cmdps.locomotion.walker:BipedalWalker", horizon=1000,
        bounds=(-150.0, 300.0), paper_bounds=(-200.0, 10.0), theta=0.005, presets=_SB3,
        preset_on_all="standard",
        jax=JaxFamily("mbtl.zoo.worlds.walker:BipedalWalker", _ours(_WALKER)),
    ),
    "cheetah": Family(
        entry_point="mbtl.zoo.cmdps.locomotion.cheetah:HalfCheetah", horizon=1000,
        bounds=(0.0, 6000.0), paper_bounds=(0.0, 6000.0), theta=0.005, presets=_SB3,
        preset_on_all="standard",
        jax=JaxFamily(
            "mbtl.zoo.cmdps.locomotion.cheetah_batch:HalfCheetahs", _ours(_CHEETAH), on_host=True,
        ),
    ),
}  # fmt: skip

_PER_SCALE = "px/m"
"""Unit of the walker's scale: the hull is drawn in pixels."""

LOCOMOTION_VARIANTS: Mapping[str, Variant] = {
    "walker-gravity": line(
        "walker", "gravity", "m/s^2", "0.2", 10.0, paper_step="1", version=2,
        description="BipedalWalker; gravity varies",
    ),
    "walker-friction": line(
        "walker", "friction", "1", "0.1", 2.5, paper_step="0.25", version=2,
        description="BipedalWalker; the friction of the ground varies",
    ),
    "walker-scale": line(
        "walker", "scale", _PER_SCALE, "1", 30.0, paper_step="3", version=2,
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
        "cheetah", "gravity", "m/s^2", "0.981", 9.81, paper_step="0.98",
        description="HalfCheetah; gravity varies",
    ),
    "cheetah-friction": line(
        "cheetah", "friction", "1", "0.04", 0.4, paper_step="0.06",
        description="HalfCheetah; sliding friction varies",
    ),
    "cheetah-stiffness": line(
        "cheetah", "stiffness", "1", "0.1", 1.0,
        description="HalfCheetah; the stiffness of all driven joints varies, as a factor",
    ),
}  # fmt: skip


# ---- the traffic part of the table of our CMDPs (cmdp-spec, sections 2, 5, 6 and 7) ----------
#
# SUMO is the simulator of all ten. All have a twin, in which they are simulated by default. Nothing
# here imports an environment.


_SCORE = Score("score")

# ---- advisory autonomy: ring and ramp --------------------------------------------------------

_TRPO: Mapping[str, Any] = {
    "n_steps": "episode", "gamma": 0.999, "gae_lambda": 1.0, "n_critic_updates": 1,
    "cg_max_steps": 10, "cg_damping": 0.1, "line_search_shrinking_factor": 0.5,
    "line_search_max_iter": 10, "target_kl": 0.01, "normalize_advantage": False,
}  # fmt: skip
"""As near to cmdp-spec, 7.4, as sb3-contrib's TRPO comes: an update is one episode long, and the
deviation of the Gaussian does not depend on the state. Its rewards are scaled but not centred."""

_RING_TRPO = {**_TRPO, "learning_rate": 1e-4, "batch_size": 400}
_RAMP_TRPO = {**_TRPO, "learning_rate": 1e-3}
_NEAR_SIGHTED = {"gamma": 0.9, "n_critic_updates": 10, "normalize_advantage": True}
"""For few episodes on the ramp: what an instruction does to the traffic shows within ten of them,
and all that comes later is noise. `evidence/recipes.py ramp-acc --engine sumo`
has what it is worth."""

_IN_TWIN = Preset(
    budget=15, episodes=1000, eval_episodes=50, algorithm="TRPO", checkpoint="best",
    checkpoint_episodes=10,
    description="the paper's recipe and episodes, best-of-evaluations policy",
)  # fmt: skip
_TWIN_PRESETS = {
    "paper": _IN_TWIN,
    "quick": replace(
        _IN_TWIN, budget=10, episodes=100, eval_episodes=10,
        description="a first look, best-of-evaluations policy",
    ),
}  # fmt: skip

_NEAR_SIGHTED_IN_TWIN = {
    "n_episodes": 4,  # as the spec recommends; they cost little more than one
    "gamma": 0.9, "critic_passes": 10, "normalize_advantage": True,
}  # fmt: skip
_RAMP_IN_TWIN = replace(
    _IN_TWIN, recipe_name="team", hyperparameters=_NEAR_SIGHTED_IN_TWIN,
    description="the paper's episodes, near-sighted, best-of-evaluations policy",
)  # fmt: skip
_RAMP_TWIN_PRESETS = {
    "standard": _RAMP_IN_TWIN,
    "quick": replace(
        _RAMP_IN_TWIN, budget=10, episodes=100, eval_episodes=10, description="a first look"
    ),
    "paper": replace(_IN_TWIN, recipe_name="team"),
}


def _in_sumo(
    hyperparameters: Mapping[str, Any], for_few: Mapping[str, Any], **changes: Any
) -> Mapping[str, Preset]:
    """Advisory autonomy by Stable-Baselines3; an episode of 500 s takes up to a second.

    Args:
        hyperparameters: the paper's.
        for_few: those that differ where there are fewer episodes.
        **changes: of all presets.
    """
    paper = Preset(
        budget=15, episodes=1000, eval_episodes=50, algorithm="TRPO",
        hyperparameters=hyperparameters, acting="sampled", checkpoint="best",
        checkpoint_episodes=10,
        description="the paper's episodes in SUMO: a quarter of an hour per policy",
    )  # fmt: skip
    paper = replace(paper, **changes)
    standard = replace(
        paper, episodes=200, eval_episodes=5, checkpoint="final",
        hyperparameters={**hyperparameters, **for_few},
        description="a fifth of the paper's episodes in SUMO, final policy",
    )  # fmt: skip
    quick = replace(
        standard, budget=10, episodes=40, eval_episodes=2,
        description="a first look in SUMO, final policy",
    )  # fmt: skip
    return {"standard": standard, "quick": quick, "paper": paper}


def _applied(actions: str) -> Mapping[str, Any]:
    """Accelerations have bounds, and are learnt from within them; speeds are choices."""
    return {"clip_actions": True} if actions == "acceleration" else {}


def _ring(name: str, actions: str) -> Family:
    return Family(
        entry_point=f"mbtl.zoo.cmdps.traffic.ring:{name}", horizon=400, bounds=(0.0, 4.5),
        theta=0.005, presets=_in_sumo(_RING_TRPO, {}, normalize_reward=True, **_applied(actions)),
        jax=TwinFamily(
            "mbtl.zoo.cmdps.traffic.twins:RingProblem", _TWIN_PRESETS, {"actions": actions},
        ),
        in_processes=_TWIN_PRESETS, switches=("obs",), simulator="sumo", visibility="hidden",
        visibility_on_all="hidden", check_steps=6, score=_SCORE,
    )  # fmt: skip


def _ramp(name: str, actions: str, checkpoint: str) -> Family:
    return Family(
        entry_point=f"mbtl.zoo.cmdps.traffic.ramp:{name}", horizon=400, bounds=(0.0, 8.78),
        metrics=_RAMP_SEES, theta=0.005,
        presets=_in_sumo(
            _RAMP_TRPO, _NEAR_SIGHTED, checkpoint=checkpoint, credit="team", **_applied(actions),
        ),
        jax=TwinFamily(
            "mbtl.zoo.cmdps.traffic.twins:RampProblem", _RAMP_TWIN_PRESETS, {"actions": actions},
        ),
        in_processes=_RAMP_TWIN_PRESETS, switches=("obs",), simulator="sumo", visibility="hidden",
        visibility_on_all="hidden", check_steps=6, score=_SCORE,
    )  # fmt: skip


# ---- traffic signal --------------------------------------------------------------------------

_DQN: Mapping[str, Any] = {
    "learning_rate": 1e-3, "gamma": 0.75, "buffer_size": 50_000, "batch_size": 100,
    "learning_starts": 100, "train_freq": (1, "episode"), "gradient_steps": 800,
    "target_update_interval": 20,  # decisions, fewer than any episode has; each is a copy
    "exploration_fraction": 1.0, "exploration_initial_eps": 1.0,
    "exploration_final_eps": 0.0, "policy_kwargs": {"net_arch": [400] * 4, "activation_fn": "Mish"},
}  # fmt: skip
"""cmdp-spec, 5, in Stable-Baselines3's DQN. It has a target network, refreshed after each episode,
and a Huber loss; epsilon falls with every step, not with every episode. Its gradients are clipped,
and waiting times are in the thousands where traffic is dense: so rewards are brought to one scale,
without which no policy learnt there within 25 episodes."""


_DQN_OF_FEW: Mapping[str, Any] = {
    **_DQN, "learning_rate": "lin_1e-3", "gradient_steps": 400,
    "replay_buffer_class": "mbtl.zoo.cmdps.traffic.rotation:RotatedReplay",
    "policy_kwargs": {"net_arch": [128] * 2, "activation_fn": "Mish"},
}  # fmt: skip
"""For few episodes: what was seen is turned by quarters, and learnt from by a small network at a
rate that falls. `evidence/recipes.py signal-inflow --engine sumo` has what each is worth."""


def _signal(hyperparameters: Mapping[str, Any], **changes: Any) -> Preset:
    preset = Preset(
        budget=15, episodes=100, eval_episodes=50, algorithm="DQN", hyperparameters=hyperparameters,
        normalize_reward=True, checkpoint="final",
    )  # fmt: skip
    return replace(preset, **changes)


_SIGNAL = {
    "standard": _signal(
        _DQN_OF_FEW,
        episodes=30,
        eval_episodes=2,  # a draw of demand in eight is much denser; the fewer, the more luck
        description="a third of the paper's episodes with turned observations, a small network",
    ),
    "quick": _signal(
        _DQN_OF_FEW,
        budget=8, episodes=15, eval_episodes=1, description="a first look, final policy",
    ),
    "paper": _signal(_DQN, description="the paper's budget, final policy"),
}  # fmt: skip

_SIGNAL_PPO = Preset(
    budget=15, episodes=100, eval_episodes=4, algorithm="PPO", recipe_name="fast",
    hyperparameters={"n_episodes": 4}, checkpoint="final", checkpoint_every=100,
    checkpoint_episodes=1,
    description="the paper's episodes, by PPO on whole episodes instead of DQN",
)  # fmt: skip

_SIGNAL_TWIN = {
    "standard": replace(_SIGNAL_PPO, description=f"{_SIGNAL_PPO.description}, in the twin"),
    "quick": replace(
        _SIGNAL_PPO, budget=8, episodes=40, eval_episodes=2, checkpoint_every=40,
        description="a first look, in the twin",
    ),
    "paper": replace(
        _SIGNAL_PPO, algorithm="DQN", recipe_name="paper", hyperparameters={}, eval_episodes=50,
        description="the paper's episodes and its DQN, in the twin; minutes a training",
    ),
}  # fmt: skip

# ---- eco-driving -----------------------------------------------------------------------------

_PPO: Mapping[str, Any] = {
    "n_steps": "episode", "learning_rate": 1e-4, "gamma": 0.99, "gae_lambda": 0.97,
    "clip_range": 0.03, "clip_range_vf": 3.0, "vf_coef": 1.0, "ent_coef": 0.005, "target_kl": 0.02,
    "n_epochs": 10, "batch_size": 256, "normalize_advantage": False,
    "policy_kwargs": {"net_arch": [256] * 4, "activation_fn": "Tanh"},
}  # fmt: skip
"""cmdp-spec, 6.3, in Stable-Baselines3's PPO, which has no adaptive KL penalty, and a deviation
that does not depend on the state."""


def _eco_in_sumo(episodes: int, **changes: Any) -> Preset:
    preset = Preset(
        budget=15, episodes=episodes, eval_episodes=100, algorithm="PPO", hyperparameters=_PPO,
        checkpoint="final",
    )  # fmt: skip
    return replace(preset, **changes)


_ECO = {
    "standard": _eco_in_sumo(
        200, eval_episodes=5, description="a twenty-fifth of the paper's episodes, final policy"
    ),
    "quick": _eco_in_sumo(30, budget=10, eval_episodes=2, description="a first look, final policy"),
    "paper": _eco_in_sumo(5000, description="the paper's episodes, final policy"),
}

_ECO_STANDARD = Preset(
    budget=15, episodes=160, eval_episodes=20, algorithm="PPO", recipe_name="glide", reward="road",
    actions="speed", acting="mean", checkpoint="final", checkpoint_episodes=1,
    description="begins with a hand-written rule and learns speeds by delay, in the twin",
)  # fmt: skip
_ECO_TWIN = {
    "standard": _ECO_STANDARD,
    "quick": replace(
        _ECO_STANDARD, budget=8, episodes=60, eval_episodes=5,
        description="a first look, in the twin",
    ),
    "paper": Preset(
        budget=15, episodes=5000, eval_episodes=100, algorithm="PPO", recipe_name="paper",
        acting="mean", checkpoint="final",
        description="the paper's budget in the twin: hours per policy without a GPU",
    ),
}  # fmt: skip

_FLOW = {"throughput": "cars/h", "co2": "g CO2/trip", "stops": "stops/trip"}
_SIGNAL_SEES = {"mean_queue": "halted cars", "mean_speed": "m/s on the roads",
                "not_inserted": "cars outside at the end"}  # fmt: skip
_RAMP_SEES = {"throughput": "cars/h", "dropped": "of the cars found no room to enter"}

TRAFFIC_FAMILIES: Mapping[str, Family] = {
    "signal": Family(
        entry_point="mbtl.zoo.cmdps.traffic.signal:Signal", horizon=540, bounds=(-120.0, 0.0),
        metrics=_SIGNAL_SEES,
        scores={"delay": {}, "paper": {"bounds": (-100.0, 0.0), "floor": -100.0}}, theta=0.001,
        presets=_SIGNAL, jax=TwinFamily("mbtl.zoo.cmdps.traffic.twins:SignalProblem", _SIGNAL_TWIN),
        in_processes={"standard": _SIGNAL_PPO}, simulator="sumo", visibility="hidden",
        check_steps=40, floor=-120.0, score=Score("score", foretold="final_score", strata="strata"),
    ),
    "eco": Family(
        entry_point="mbtl.zoo.cmdps.traffic.eco:Eco",
        horizon=1500,
        bounds=(0.0, 14.0),  # nobody drives, everybody at the limit
        metrics={"trip_speed": "m/s in the region", **_FLOW},
        scores={
            "everyone": {},
            "paper": {
                "bounds": (0.0, 15.0),
                "metrics": {"mean_speed": "m/s of all cars", **_FLOW},
            },
        },
        theta=0.005,
        presets=_ECO,
        jax=TwinFamily("mbtl.zoo.cmdps.traffic.twins:EcoProblem", _ECO_TWIN),
        in_processes={"paper": _ECO_TWIN["paper"]},
        simulator="sumo",
        check_steps=60,
        score=_SCORE,
    ),
    "ring-acc": _ring("RingAcc", "acceleration"), "ring-vel": _ring("RingVel", "speed"),
    "ramp-acc": _ramp("RampAcc", "acceleration", "final"),
    "ramp-vel": _ramp("RampVel", "speed", "best"),
}  # fmt: skip


def _hold(family: str, description: str) -> Variant:
    return line(family, "hold", "s", "1", 1.0, n=40, version=1, description=description)


TRAFFIC_VARIANTS: Mapping[str, Variant] = {
    "signal-length": line(
        "signal", "length", "m", "50", 750.0, n=50, paper_step="75", version=4,
        description="Traffic signal; the length of the approaches varies",
    ),
    "signal-inflow": line(
        "signal", "inflow", "cars", "50", 1000.0, n=50, version=4,
        description="Traffic signal; the demand varies",
    ),
    "signal-speed": line(
        "signal", "speed", "m/s", "0.5", 14.0, n=50, paper_step="1.389", version=4,
        description="Traffic signal; the speed limit varies",
    ),
    "eco-penetration": line(
        "eco", "penetration", "share", "0.02", 0.2, n=50, version=2,
        description="Eco-driving; the share of controlled cars varies",
    ),
    "eco-inflow": line(
        "eco", "inflow", "veh/h", "40", 400.0, n=50, version=2, visibility="hidden",
        description="Eco-driving; the demand varies",
    ),
    "eco-green": line(
        "eco", "green", "s", "1", 35.0, n=50, paper_step="3.5", version=2,
        description="Eco-driving; the green time varies",
    ),
    "ring-acc": _hold("ring-acc", "Ring road, accelerations advised; the hold varies"),
    "ring-vel": _hold("ring-vel", "Ring road, speeds advised; the hold varies"),
    "ramp-acc": _hold("ramp-acc", "Highway ramp, accelerations advised; the hold varies"),
    "ramp-vel": _hold("ramp-vel", "Highway ramp, speeds advised; the hold varies"),
}  # fmt: skip


# ---- the whole -------------------------------------------------------------------------------


def _paper(timesteps: int) -> Preset:
    return Preset(
        budget=15, timesteps=timesteps, eval_episodes=100, algorithm="PPO", checkpoint="best",
        checkpoint_episodes=10,
        description="the paper's budget: SB3 default PPO, best-of-evaluations policy",
    )  # fmt: skip


_CARTPOLE = {
    "quick": Preset(
        budget=10, timesteps=40_000, eval_episodes=10, algorithm="PPO", checkpoint="final",
        description="minutes on a laptop: SB3 default PPO, final policy",
    ),
    "paper": _paper(5_000_000),
}  # fmt: skip

_PENDULUM_PPO = {"learning_rate": 1e-3, "gamma": 0.9, "n_steps": 1024}
"""SB3's default PPO needs about a million steps here; these need about a tenth."""

_PENDULUM = {
    "quick": Preset(
        budget=10, timesteps=100_000, eval_episodes=10, algorithm="PPO",
        hyperparameters=_PENDULUM_PPO, checkpoint="final", n_envs=4,
        description="minutes on a laptop: PPO tuned for short training, final policy",
    ),
    "paper": _paper(1_000_000),
}  # fmt: skip


def _jax(
    environment: str, paper_steps: int, hyperparameters: Mapping[str, Any] | None = None
) -> JaxFamily:
    """The paper's steps are the default here: a policy takes seconds."""
    full = Preset(
        budget=15, timesteps=paper_steps, eval_episodes=100, algorithm="PPO", recipe_name="fast",
        hyperparameters=hyperparameters, checkpoint="best", checkpoint_episodes=10,
        description="the paper's steps with our faster recipe, best-of-evaluations policy",
    )  # fmt: skip
    return JaxFamily(
        environment,
        {
            "full": full,
            "quick": replace(
                full, budget=10, timesteps=100_000, eval_episodes=10,
                description="a first look with our faster recipe, best-of-evaluations policy",
            ),
            "paper": replace(
                full, recipe_name="sb3", hyperparameters=None,
                description="the paper's steps and hyper-parameters (SB3's default PPO), "
                "best-of-evaluations policy: several times slower than `full`",
            ),
        },
    )  # fmt: skip


_PENDULUM_JAX = {
    "n_envs": 4, "n_steps": 512, "n_epochs": 2, "learning_rate": 1e-3, "gamma": 0.95,
    "max_grad_norm": 5.0,
}  # fmt: skip
"""As good as SB3's default PPO after a million steps; one pass over shorter rollouts is not."""


FAMILIES: Mapping[str, Family] = {
    "cartpole": Family(
        entry_point="mbtl.zoo.cmdps.cartpole:CartPole", horizon=500, bounds=(0.0, 500.0),
        best_return=500.0, theta=0.005, presets=_CARTPOLE,
        jax=_jax("mbtl.zoo.worlds:CartPole", 5_000_000, {"gamma": 0.99}), switches=("physics",),
    ),
    "pendulum": Family(
        entry_point="mbtl.zoo.cmdps.pendulum:Pendulum", horizon=200, bounds=(-2200.0, -500.0),
        theta=0.005, presets=_PENDULUM,
        jax=_jax("mbtl.zoo.worlds:Pendulum", 1_000_000, _PENDULUM_JAX),
    ),
    **LOCOMOTION_FAMILIES, **TRAFFIC_FAMILIES,
}  # fmt: skip


VARIANTS: Mapping[str, Variant] = {
    "cartpole-masscart": line(
        "cartpole", "masscart", "kg", "0.1", 1.0, description="CartPole; the cart mass varies",
    ),
    "cartpole-length": line(
        "cartpole", "length", "m", "0.05", 0.5,
        description="CartPole; half the pole's length varies",
    ),
    "cartpole-masspole": line(
        "cartpole", "masspole", "kg", "0.01", 0.1, description="CartPole; the pole mass varies",
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
        "pendulum", "length", "m", "0.1", 1.0, description="Pendulum; the length varies",
    ),
    "pendulum-mass": line(
        "pendulum", "mass", "kg", "0.1", 1.0, description="Pendulum; the mass varies",
    ),
    "pendulum-timestep": line(
        "pendulum", "timestep", "s", "0.005", 0.05,
        description="Pendulum; the time between two actions varies",
    ),
    **LOCOMOTION_VARIANTS, **TRAFFIC_VARIANTS,
}  # fmt: skip
