"""A traffic light under any demand on one of its roads, in your own SUMO network or a crossing.

NET=yours.net.xml python examples/own_sumo_network.py       # needs mbtl[traffic,train,plots]
NET=yours.net.xml mbtl check examples/own_sumo_network.py:problem
"""

import os
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import sumolib

import mbtl
from mbtl.zoo.cmdps.traffic import simulation

AT = {"x": (0, 0), "e": (300, 0), "n": (0, 300), "w": (-300, 0), "s": (0, -300)}  # metres
NODES = "".join(f'<node id="{name}" x="{x}" y="{y}"/>' for name, (x, y) in AT.items())
WAYS = ("ex", "xe", "nx", "xn", "wx", "xw", "sx", "xs")
EDGES = "".join(f'<edge id="{a}{b}" from="{a}" to="{b}"/>' for a, b in WAYS)
CROSSING = {"nodes": f"<nodes>{NODES}</nodes>", "edges": f"<edges>{EDGES}</edges>"}


class Light(gym.Env):
    """Every 10 s for 10 minutes: 0 keeps the green, 1 goes on in the light's own program."""

    def __init__(self, context):
        net = os.environ.get("NET") or str(simulation.network(CROSSING, "--tls.set", "x"))
        self.context, self.simulation = context, simulation.Simulation(net, step_length=1.0)
        light = sumolib.net.readNet(net).getTrafficLights()[0]
        links = [(a.getEdge().getID(), b.getEdge().getID()) for a, b, _ in light.getConnections()]
        self.id, self.ways, self.roads = light.getID(), sorted(set(links)), sorted(dict(links))
        self.observation_space = gym.spaces.Box(0, np.inf, (len(self.roads) + 1,))
        self.action_space = gym.spaces.Discrete(2)
        self.close = self.simulation.close

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        cars, self.queues = "", []
        for a, b in self.ways:  # cars per hour and way: the context's on the first road
            rate = (self.context["demand"] if a == self.roads[0] else 70) / 3600
            cars += f'<flow id="{a}_{b}" from="{a}" to="{b}" end="600" probability="{rate}"/>'
        self.simulation.start(f"<routes>{cars}</routes>", int(self.np_random.integers(2**31)))
        return self.look(), {}

    def look(self):
        with self.simulation.guard() as sumo:
            halted = [sumo.edge.getLastStepHaltingNumber(road) / 10 for road in self.roads]
            self.queues.append(10 * sum(halted) + len(sumo.simulation.getPendingVehicles()))
            return np.array([*halted, sumo.trafficlight.getPhase(self.id)], np.float32)

    def step(self, action):
        with self.simulation.guard() as sumo:
            if action is not None and "y" not in sumo.trafficlight.getRedYellowGreenState(self.id):
                sumo.trafficlight.setPhaseDuration(self.id, 0.0 if action else 20.0)
            sumo.simulationStep(sumo.simulation.getTime() + 10.0)
        seen, ended = self.look(), len(self.queues) > 60
        score = {"score": -np.mean(self.queues)} if ended else {}  # evaluated, not the return
        return seen, -self.queues[-1] / 20, False, ended, score


problem = mbtl.CMDP.from_env(
    "own-light", mbtl.ContextSpace.grid({mbtl.Linear("demand", 40, 400, unit="veh/h"): 10}),
    make_env=Light, score="score", algorithm="DQN", timesteps=3000, eval_episodes=2, budget=3,
    hyperparameters={"gamma": 0.9, "learning_rate": 1e-3, "target_update_interval": 200},
    bounds=(-40.0, 0.0), trainer_options={"n_eval_envs": 1},  # libsumo holds one simulation
)  # fmt: skip

if __name__ == "__main__":
    portfolio, context = problem.study().run().portfolio(), {"demand": 250}
    program = SimpleNamespace(predict=lambda seen, **_: ([None] * len(seen), None))
    for name, policy in {"portfolio": portfolio.policy_for(context), "program": program}.items():
        print(name, "cars waiting:", -problem.trainer.evaluate(policy, [context], [1]).mean())
