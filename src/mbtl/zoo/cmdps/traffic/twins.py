"""The traffic environments that have a twin in jax: which one, with the constants of SUMO's.

No constant is written twice: the twins take theirs from the environments. SUMO need not be there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from mbtl.contexts import Context
from mbtl.zoo.cmdps.contextual import TimeLimit, Visibility, full_context, visible_features
from mbtl.zoo.cmdps.traffic import advisory, ring
from mbtl.zoo.cmdps.traffic.advisory import Actions, Seen

_ROWS = 64
"""Cars of a lane of the signal's twin at the nominal demand: half a kilometre that stands."""


@dataclass(frozen=True)
class RingProblem:
    """contexts -> twin of the ring and its parameters (`mbtl.zoo.cmdps.engines.TwinProblem`).

    Attributes:
        actions: what is advised.
        unit: the hold at multiplier 1.
        visibility: what of the context the policy sees.
        time_limit: how the end of an episode is reported.
        obs: see `mbtl.zoo.cmdps.traffic.ring.Ring`.
        noise: of the drivers [m/s^2].
        start: cars at rest with random gaps ("free"), or with equal ones ("uniform").
    """

    actions: Actions
    unit: Mapping[str, float] = field(default_factory=lambda: dict(ring.Ring.FEATURES))
    visibility: Visibility = "hidden"
    time_limit: TimeLimit = "truncation"
    obs: Seen = "fresh"
    noise: float = advisory.NOISE
    start: ring.Start = "free"

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, list[Any]]:
        """The twin, and the parameters of each context.

        Raises:
            ContextMismatch: a hold is no whole number of simulation steps.
        """
        from mbtl.zoo.worlds.traffic.idm import IDM
        from mbtl.zoo.worlds.traffic.ring import RingTwin

        twin = RingTwin(
            cars=ring.CARS,
            circumference=ring.CIRCUMFERENCE,
            car_length=advisory.LENGTH,
            min_gap=advisory.MIN_GAP,
            advised_min_gap=ring.CLOSEST,
            driver=IDM(advisory.ACCEL, advisory.DECEL, advisory.TAU),
            road_limit=advisory.ROAD_LIMIT,
            dt=advisory.STEP,
            reach=ring.REACH,
            uniform=self.start == "uniform",
            **_advised(self, ring),
        )
        return twin, _holds(contexts, ring.Ring.FEATURES, self.unit, self.visibility)


@dataclass(frozen=True)
class EcoProblem:
    """contexts -> twin of the eco-driving road and its parameters (`engines.TwinProblem`).

    Attributes:
        unit: varied features and their value at multiplier 1.
        visibility: what of the context the policy sees.
        time_limit: how the end of an episode is reported.
        score: what an episode is worth, see `mbtl.zoo.cmdps.traffic.eco`.
        agents: most controlled cars that are agents at once; any beyond drive by themselves.
    """

    unit: Mapping[str, float] = field(default_factory=dict)
    visibility: Visibility = "hidden"
    time_limit: TimeLimit = "truncation"
    score: Literal["everyone", "paper"] = "everyone"
    agents: int = 40

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, list[Any]]:
        """The twin, and the parameters of each context.

        Raises:
            ContextMismatch: a penetration outside (0, 1], or a green that no signal can show.
        """
        import jax.numpy as jnp

        from mbtl.engine.worlds.environments import Box
        from mbtl.zoo.cmdps.traffic import eco
        from mbtl.zoo.worlds.traffic.eco import (
            Costs,
            Demand,
            EcoParams,
            EcoTwin,
            Kind,
            Light,
            Look,
            Road,
            Stops,
        )

        west, south = eco.FEEDERS["AB"], eco.FEEDERS["AA"]
        shortest = eco.CONTROLLED_LENGTH + eco.CONTROLLED.min_gap
        twin = EcoTwin(
            action=Box((eco.HARDEST,), (eco.STRONGEST,)),
            road=Road(
                feeders=(west, south),
                line=eco.STARTS[1],
                box=eco.STARTS[2],
                end=eco.LENGTH,
                limit=eco.LIMIT,
                entry_speed=eco.DEPART_SPEED,
            ),
            light=Light(eco.YELLOW, eco.RED),
            demand=Demand(
                kinds=tuple(
                    Kind(kind.share, kind.length, tuple(kind.mean), tuple(kind.std))
                    for kind in eco.FLEET.values()
                ),
                cut=eco.CUT,
                controlled=tuple(eco.CONTROLLED),
                controlled_length=eco.CONTROLLED_LENGTH,
                shares=(eco.SHARES["AB"], eco.SHARES["AA"]),
            ),
            co2_rate=eco.co2_rate,
            costs=Costs(eco.CRAWL, eco.CRAWL_COST, eco.CO2_COST, eco.REWARD_SCALE),
            stop=Stops(eco.HALTED, eco.MOVING),
            look=Look(eco.SPEED_SCALE, eco.LENGTH_SCALE, eco.TIME_SCALE, eco.ABSENT),
            dt=eco.STEP,
            warm_up=eco.WARM_UP,
            horizon=eco.Eco.HORIZON,
            rows=math.ceil((west + eco.LENGTH) / shortest),
            side_rows=math.ceil(south / shortest),
            agents=self.agents,
            n_features=eco.SIZE,
            scored=self.score,
            time_limit=self.time_limit,
        )
        params = []
        for context in contexts:
            eco.check_context(context)
            features = full_context(eco.Eco.FEATURES, context)
            visible = visible_features(features, self.unit, self.visibility)
            if self.visibility == "raw":
                share, green = features["penetration"], features["green"]
                visible = (share, 1.0, eco.LIMIT / eco.SPEED_SCALE, green, eco.RED)
            params.append(
                EcoParams(
                    jnp.float32(features["penetration"]),
                    jnp.float32(features["inflow"]),
                    jnp.float32(features["green"]),
                    jnp.asarray(visible, jnp.float32),
                )
            )
        return twin, params


@dataclass(frozen=True)
class RampProblem:
    """contexts -> twin of the highway ramp and its parameters (`engines.TwinProblem`).

    Attributes:
        actions: what is advised.
        unit: the hold at multiplier 1.
        visibility: what of the context the policy sees.
        time_limit: how the end of an episode is reported.
        obs: see `mbtl.zoo.cmdps.traffic.ring.Ring`.
        noise: of the drivers [m/s^2].
    """

    actions: Actions
    unit: Mapping[str, float] = field(
        default_factory=lambda: dict(ring.Ring.FEATURES)
    )  # the hold, as there
    visibility: Visibility = "hidden"
    time_limit: TimeLimit = "truncation"
    obs: Seen = "fresh"
    noise: float = advisory.NOISE

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, list[Any]]:
        """The twin, and the parameters of each context.

        Raises:
            ContextMismatch: a hold is no whole number of simulation steps.
        """
        from mbtl.zoo.cmdps.traffic import ramp
        from mbtl.zoo.worlds.traffic.idm import IDM
        from mbtl.zoo.worlds.traffic.ramp import Drivers, Flow, RampTwin, Roads

        def flow(road: str) -> Flow:
            demand = ramp.DEMAND[road]
            first, every, patience = (
                round(seconds / advisory.STEP)
                for seconds in (ramp.FIRST, 3600.0 / demand.flow, advisory.PATIENCE)
            )
            return Flow(first, every, patience, demand.speed)

        roads = Roads(
            main=ramp.MAIN,
            side=ramp.RAMP,
            merge=ramp.MERGE,
            end=ramp.EXIT,
            gaps=ramp.ZIPPER_GAPS,
            limit=advisory.ROAD_LIMIT,
        )
        twin = RampTwin(
            roads=roads,
            drivers=Drivers(
                model=IDM(advisory.ACCEL, advisory.DECEL, advisory.TAU),
                length=advisory.LENGTH,
                min_gap=advisory.MIN_GAP,
                dt=advisory.STEP,
                roads=roads,
                impatience=advisory.IMPATIENCE,
            ),
            flows=(flow("main"), flow("ramp")),
            every=ramp.EVERY,
            push=(ramp.SPEED_UP, ramp.SLOW_DOWN),
            agents=ramp.Ramp.most_agents,
            **_advised(self, ramp),
        )
        return twin, _holds(contexts, ramp.Ramp.FEATURES, self.unit, self.visibility)


def _advised(problem: RingProblem | RampProblem, road: Any) -> dict[str, Any]:
    """What the twins of both roads with advised drivers share; `road` is the module of one."""
    from mbtl.engine.worlds.environments import Box, Discrete

    advisory.check_seen(problem.obs)
    return {
        "action": Discrete(road.LEVELS) if problem.actions == "speed" else Box((-1.0,), (1.0,)),
        "max_speed": advisory.MAX_SPEED,
        "speed_factor": advisory.SPEED_SPREAD,
        "noise": problem.noise,
        "warm_up": advisory.WARM_UP,
        "unmeasured": advisory.UNMEASURED,
        "total_steps": advisory.UNMEASURED + advisory.MEASURED,
        "top_speed": road.TOP_SPEED,
        "collision": road.COLLISION,
        "scale": road.SCALE,
        "time_limit": problem.time_limit,
        "stale": problem.obs == "stale",
    }


@dataclass(frozen=True)
class SignalProblem:
    """contexts -> twin of the traffic signal and its parameters (`engines.TwinProblem`).

    Attributes:
        unit: varied features and their value at multiplier 1.
        visibility: what of the context the policy sees.
        time_limit: how the end of an episode is reported.
        score: what an episode is worth, see `mbtl.zoo.cmdps.traffic.signal`.
    """

    unit: Mapping[str, float] = field(default_factory=dict)
    visibility: Visibility = "hidden"
    time_limit: TimeLimit = "truncation"
    score: Literal["delay", "paper"] = "delay"

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, list[Any]]:
        """The twin, and the parameters of each context.

        Raises:
            ContextMismatch: a road too short to stop on, or an inflow that is no number of cars.
        """
        import jax.numpy as jnp

        from mbtl.engine.worlds.environments import Discrete
        from mbtl.zoo.cmdps.traffic import signal
        from mbtl.zoo.worlds.traffic.crossing import CrossingParams, CrossingTwin, Krauss, Turn

        nominal = signal.Signal.FEATURES
        every = [full_context(nominal, context) for context in contexts]
        for features in every:
            signal.check_context(features)
        cars = max([nominal["inflow"], *(features["inflow"] for features in every)])
        size = 2 ** max(0, math.ceil(math.log2(cars / nominal["inflow"])))  # few programs
        twin = CrossingTwin(
            driver=Krauss(signal.ACCELERATION, signal.DECELERATION, signal.SIGMA),
            car=signal.LENGTH,
            min_gap=signal.MIN_GAP,
            max_speed=signal.MAX_SPEED,
            entry_speed=signal.entry_speed(math.inf),
            clearance=signal.CLEARANCE,
            left=Turn(signal.LEFT_SPEED, signal.LEFT_WAY),
            right=Turn(signal.RIGHT_SPEED, signal.RIGHT_WAY),
            straight=signal.STRAIGHT_SHARE,
            green=signal.GREEN,
            yellow=signal.YELLOW,
            total_seconds=signal.SECONDS,
            cells=tuple(signal.CELLS.tolist()),
            nominal_length=nominal["length"],
            halted=signal.HALTED,
            easing=0.5 * signal.ACCELERATION,
            jam=signal.SCORES[self.score].jam,
            scored=self.score,
            action=Discrete(signal.PHASES),
            cars=size * int(nominal["inflow"]),
            rows=_ROWS + _ROWS // 2 * (size - 1),
            time_limit=self.time_limit,
        )
        params = [
            CrossingParams(
                length=jnp.float32(features["length"]),
                inflow=jnp.float32(features["inflow"]),
                speed=jnp.float32(features["speed"]),
                crowded=jnp.int32(-1),
                visible=jnp.asarray(
                    visible_features(features, self.unit, self.visibility), jnp.float32
                ),
            )
            for features in every
        ]
        return twin, params


def _holds(
    contexts: Sequence[Context],
    nominal: Mapping[str, float],
    unit: Mapping[str, float],
    visibility: Visibility,
) -> list[Any]:
    """The `HoldParams` of each context.

    Raises:
        ContextMismatch: a hold is no whole number of simulation steps.
    """
    import jax.numpy as jnp

    from mbtl.engine.worlds.beats import HoldParams

    params = []
    for context in contexts:
        features = full_context(nominal, context)
        visible = visible_features(features, unit, visibility)
        hold = advisory.hold_steps(features["hold"])
        params.append(HoldParams(jnp.int32(hold), jnp.asarray(visible, jnp.float32)))
    return params
