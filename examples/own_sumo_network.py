"""The traffic lights of any SUMO scenario under any demand: yours, or a crossing of SUMO's own.

CONFIG=yours.sumocfg python examples/own_sumo_network.py       # needs mbtl[traffic,train,plots]
CONFIG=yours.sumocfg mbtl check examples/own_sumo_network.py:problem
"""

import os
from pathlib import Path

import sumo as eclipse_sumo

import mbtl
from mbtl import sumo
from mbtl.report import summarise_study

CROSSING = Path(eclipse_sumo.SUMO_HOME, "tools", "game", "cross.sumocfg")

problem = sumo.from_sumocfg(
    "own-light",
    os.environ.get("CONFIG", CROSSING),
    mbtl.ContextSpace.grid({mbtl.Linear("demand", 0.5, 2.0, unit="times"): 6}),
    {"demand": sumo.Demand()},
    timesteps=4000,
    hyperparameters={"gamma": 0.95, "learning_rate": 1e-3, "n_steps": 200, "batch_size": 50},
    eval_episodes=2,
    budget=2,
)

if __name__ == "__main__":
    summary = summarise_study(problem.study().run().study)
    delays = {"policies": summary.fresh_value} | {one.name: one.value for one in summary.baselines}
    for who, value in delays.items():
        told = {name: round(mean, 1) for name, mean in summary.metrics[who].items()}
        print(f"{who}: V {value:.3f}", told)
