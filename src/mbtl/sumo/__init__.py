"""Your own SUMO scenario as a contextual MDP: `from_sumocfg`, `from_sumo_rl`.

For example, so many times the vehicles of a scenario:

    space = mbtl.ContextSpace.grid({mbtl.Linear("demand", 0.5, 2.0, unit="times"): 10})
    problem = mbtl.sumo.from_sumocfg(
        "my-city", "city.sumocfg", space, {"demand": mbtl.sumo.Demand()}, timesteps=50_000
    )

It needs `pip install 'mbtl[traffic,train]'`, which brings SUMO.
"""

from mbtl.sumo.drawing import CARS, CONTROLLED, Legend, draw
from mbtl.sumo.environment import METRICS, KeepOrGoOn, ScenarioEnv
from mbtl.sumo.installed import network
from mbtl.sumo.problems import SumoRLEnv, from_sumo_rl, from_sumocfg
from mbtl.sumo.scenario import (
    Attribute,
    Change,
    Demand,
    Files,
    PhaseDuration,
    Scenario,
    SpeedLimit,
    TypeShare,
)  # fmt: skip
from mbtl.sumo.simulation import Engine, Simulation

__all__ = [
    "CARS", "CONTROLLED", "METRICS", "Attribute", "Change", "Demand", "Engine", "Files",
    "KeepOrGoOn", "Legend", "PhaseDuration", "Scenario", "ScenarioEnv", "Simulation", "SpeedLimit",
    "SumoRLEnv", "TypeShare", "draw", "from_sumo_rl", "from_sumocfg", "network",
]  # fmt: skip
