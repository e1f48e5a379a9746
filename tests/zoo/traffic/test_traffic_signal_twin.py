"""The signal's twin is SUMO: second by second but for the luck of drivers, and in the mean."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from played import played

from mbtl.zoo.cmdps.traffic import signal
from mbtl.zoo.cmdps.traffic.signal import APPROACHES, Signal
from mbtl.zoo.cmdps.traffic.twins import SignalProblem
from mbtl.zoo.worlds.traffic import lane
from mbtl.zoo.worlds.traffic.crossing import Queues

ROWS = 40
MEASURES = ("delay", "waiting", "mean_queue", "mean_speed")
LANES = [f"{approach}_in_{i}" for approach in APPROACHES for i in range(4)]


def snapshot(api):
    """Cars lane by lane, the foremost first: ids, and (rows, 16, 1) of what the twin knows."""
    fields = np.zeros((4, ROWS, 16, 1), np.float32)
    fields[0] = lane.EMPTY
    ids = {}
    for k, name in enumerate(LANES):
        cars = list(reversed(api.lane.getLastStepVehicleIDs(name)))
        for row, car in enumerate(cars):
            here, there = api.vehicle.getRoute(car)
            turn = (APPROACHES.index(there[0]) - APPROACHES.index(here[0])) % 4
            fields[:, row, k, 0] = (
                api.vehicle.getLanePosition(car),
                api.vehicle.getSpeed(car),
                0.0,
                turn == 3,
            )
            ids[car] = (row, k)
    return ids, Queues(*map(jnp.asarray, fields))


def test_cars_drive_on_as_in_sumo_but_for_the_drivers_luck(opened):
    env = opened(Signal({"inflow": 1500.0}, visibility="hidden"))
    twin, (params,) = SignalProblem()([{"inflow": 1500.0}])
    speeds = jax.jit(twin._speeds)
    beyond, cars = [], 0
    env.reset(seed=0)
    for k in range(150):
        env.step((k // 2) % 4)
    with env.simulation.guard() as api:
        green = np.array([[c == "G"] for c in _lights(api)])
        for _ in range(60):
            ids, queues = snapshot(api)
            fast, slow = (
                np.asarray(speeds(queues, jnp.asarray(green), jnp.float32(luck), params))
                for luck in (0.0, 1.0)
            )
            fields = jax.tree.map(np.asarray, queues)
            api.simulationStep(0.0)
            now, _ = snapshot(api)
            for car, (row, k) in ids.items():
                if car not in now or now[car][1] != k:
                    continue  # it has left, or changed lanes
                v = api.vehicle.getSpeed(car)
                low, high = slow[row, k, 0] - 0.01, fast[row, k, 0] + 0.01
                # who is first may follow a car in the box, which is not in the picture
                first = row == 0 and fields.x[row, k, 0] > 600.0
                cars += not first
                if not first and not low <= v <= high:
                    beyond.append((car, v, low, high))
    assert cars > 1500
    assert len(beyond) < 0.03 * cars, beyond[:10]


def _lights(api):
    """Letter of each lane's light."""
    state = api.trafficlight.getRedYellowGreenState("centre")
    links = api.trafficlight.getControlledLinks("centre")
    letters = {link[0][0]: letter for link, letter in zip(links, state, strict=True) if link}
    return [letters[name] for name in LANES]


@pytest.mark.long
@pytest.mark.parametrize("features", [{"inflow": 300.0}, {}, {"length": 100.0}, {"speed": 25.0}])
def test_a_light_that_takes_turns_costs_as_much_as_in_sumo(features, opened):
    seeds, held = 6, 3
    env = opened(Signal(features, visibility="hidden"))
    found = []
    for seed in range(seeds):
        env.reset(seed=seed)
        phases = (k // held % 4 for k in itertools.count())
        outcomes = played(lambda each=phases: env.step(next(each)))
        found.append([outcomes[-1][4][name] for name in MEASURES])
    twin, (params,) = SignalProblem()([features])
    state = twin.start(jnp.arange(64, dtype=jnp.uint32), params)

    def one(k, state):
        return twin.step(state, jnp.full((64, 1), (k // held) % 4), params).state

    state = jax.jit(lambda state: jax.lax.fori_loop(0, signal.SECONDS // 10, one, state))(state)
    ours = np.array([twin.measures(state)[k] for k in MEASURES])
    theirs = np.array(found)
    error = np.hypot(theirs.std(axis=0) / seeds**0.5, ours.std(axis=1) / 8.0)
    allowed = 4.0 * error + 0.01 * np.abs(theirs.mean(axis=0))
    assert (np.abs(theirs.mean(axis=0) - ours.mean(axis=1)) <= allowed).all()
