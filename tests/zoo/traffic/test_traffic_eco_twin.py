"""The eco-driving twin is SUMO step for step with the same cars."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.problems import get_cmdp
from mbtl.zoo.cmdps.traffic import eco
from mbtl.zoo.cmdps.traffic.eco import FEEDERS, STARTS
from mbtl.zoo.cmdps.traffic.twins import EcoProblem
from mbtl.zoo.worlds.traffic.eco import Car as Waiting
from mbtl.zoo.worlds.traffic.eco import Demand, EcoTwin

ATOL = 2e-3  # m, m/s, and what follows from them


START, STEP, OBSERVE = (
    jax.jit(method, static_argnums=0) for method in (EcoTwin.start, EcoTwin.step, EcoTwin.observe)
)


@dataclass(frozen=True)
class Script(Demand):
    """The cars of an episode in SUMO, as a demand of the twin: per feeder (gap, *car) each."""

    given: tuple[tuple[tuple[float, ...], ...], ...] = ()

    @classmethod
    def of(cls, demand, cars):
        given = []
        for feeder in FEEDERS:
            mine = [c for c in cars if c.feeder == feeder]
            times = [0.0, *(round(c.depart, 3) for c in mine), 1e9]  # SUMO counts in ms
            drivers = [(c.length, *c.driver, c.controlled) for c in [*mine, mine[-1]]]
            gaps = np.diff(times).tolist()
            given.append(tuple((g, *d) for g, d in zip(gaps, drivers, strict=True)))
        return cls(**vars(demand), given=tuple(given))

    def draw(self, seed, number, inflow, penetration):
        rows = []
        for k in (0, 1):
            table = jnp.array(self.given[k], jnp.float32)
            rows.append(table[jnp.minimum(number[k], len(table) - 1)].T)
        gap, *car = jnp.stack(rows, axis=1)
        return gap, Waiting(*car[:-1], car[-1].astype(jnp.int32))


def in_sumo(api):
    """Fronts and speeds of the cars of `main` and `side`, the foremost first."""
    starts = dict(zip(("approach", "box", "exit"), STARTS, strict=True), AB=-FEEDERS["AB"])
    x, v = api.vehicle.getLanePosition, api.vehicle.getSpeed

    def rows(roads):
        cars = [
            (begin + x(id), v(id))
            for road, begin in roads.items()
            for id in api.lane.getLastStepVehicleIDs(f"{road}_0")
        ]
        return np.array(sorted(cars, reverse=True)).reshape(-1, 2)

    return rows(starts), rows({"AA": -FEEDERS["AA"]})


def in_twin(cars):
    there = np.asarray(cars.x)[:, 0] > -1e3
    return np.stack([cars.x, cars.speed])[:, there, 0].T


def injected(cars, rows):
    """The same cars where SUMO has them, so that errors do not add up."""
    x, speed = np.array(cars.x), np.array(cars.speed)
    x[: len(rows), 0], speed[: len(rows), 0] = rows.T
    return cars._replace(x=x, speed=speed)


MORE = ({"penetration": 1.0}, {"inflow": 1200.0, "green": 20.0}, {"green": 3.0})


@pytest.mark.parametrize(
    "context", [{}, *(pytest.param(one, marks=pytest.mark.long) for one in MORE)], ids=str
)
def test_with_the_same_cars_every_step_is_as_in_sumo(context, monkeypatch, opened):
    drawn = []
    original = eco.population
    monkeypatch.setattr(eco, "population", lambda *args: drawn.append(original(*args)) or drawn[-1])
    monkeypatch.setattr(eco.Eco, "_wait", lambda *_: None)  # compare without agents too
    env = opened(eco.Eco(context, visibility="hidden", horizon=240))
    twin, (params,) = EcoProblem()([context])
    actions = np.zeros((1, twin.agents, 1), np.float32)
    rng = np.random.default_rng(0)
    moves = wrong = 0
    seen, _ = env.reset(seed=1)
    # rows of two lengths, so that there is less to compile
    twin = replace(twin, demand=Script.of(twin.demand, drawn[-1]), few=twin.few[:1])
    state = START(replace(twin, warm_up=0), jnp.zeros(1, jnp.uint32), params)
    for _ in range(eco.WARM_UP):
        state = STEP(twin, state, actions, params).state
    while env._left > 0:
        main, side = in_sumo(env.simulation.api)
        for cars, sumo in ((state.main, main), (state.side, side)):
            error = np.abs(in_twin(cars) - sumo).max(axis=1, initial=0.0)
            moves += len(sumo)
            wrong += int((error > ATOL).sum())
        state = state._replace(main=injected(state.main, main), side=injected(state.side, side))
        now = OBSERVE(twin, state, params)
        places = (int(state.first[0]) + np.arange(len(env.agents))) % twin.agents
        acting = np.zeros(twin.agents, bool)
        acting[places] = True
        np.testing.assert_array_equal(now.acting[0], acting)
        for place, car in zip(places, env.agents, strict=True):
            np.testing.assert_allclose(now.obs[0, place], seen[car], atol=ATOL, err_msg=car)
        told = {car: np.float32([rng.normal(0.0, 3.0)]) for car in env.agents}
        actions = np.zeros_like(actions)
        actions[0, places] = np.reshape(list(told.values()), (-1, 1))
        seen, rewards, ended, *_ = env.step(told)
        moved = STEP(twin, state, actions, params)
        state = moved.state
        for place, car in zip(places, told, strict=True):
            assert float(moved.reward[0, place]) == pytest.approx(rewards[car], abs=0.01)
            assert bool(moved.done[0, place]) == ended[car] or env._left == 0
    assert wrong <= moves // 10_000, (wrong, moves)
    assert moves > 1500
    measures = {name: float(value[0]) for name, value in twin.measures(state).items()}
    assert measures["completed"] > 0
    assert measures == pytest.approx({name: env.summary[name] for name in measures}, rel=1e-3)
    for score, measure in eco.SCORES.items():
        assert float(replace(twin, scored=score).score(state)[0]) == measures[measure]


@pytest.mark.long
def test_sumo_tells_what_stands_beside_the_score_whoever_trains():
    contexts, names = [{"green": 16.0}, {"green": 35.0}], ("throughput", "co2", "stops")
    policy = get_cmdp("eco-green", engine="sumo-jax").trainer_for().untrained(contexts[0])
    found = {}
    for how in ("sumo", "sumo-jax"):
        trainer = get_cmdp("eco-green", engine=how).trainer_for(acting="mean", eval_episodes=1)
        found[how] = {w: trainer.measure(w, contexts, [3, 5], names) for w in (policy, "unguided")}
        scores = trainer.evaluate(policy, contexts, [3, 5])
        np.testing.assert_allclose(found[how][policy]["score"], scores, rtol=1e-6)
    for who in (policy, "unguided"):
        for name in names:
            one, other = (found[how][who][name] for how in ("sumo", "sumo-jax"))
            np.testing.assert_array_equal(one, other)
            assert (one > 0.0).any(), name  # by an untrained policy nobody may get through
