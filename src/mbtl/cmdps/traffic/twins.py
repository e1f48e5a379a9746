"""The traffic environments that have a twin in jax: which one, with the constants of SUMO's.

No constant is written twice: the twins take theirs from the environments. SUMO need not be there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mbtl.cmdps.contextual import TimeLimit, Visibility, full_context, visible_features
from mbtl.cmdps.traffic import advisory, ring
from mbtl.cmdps.traffic.advisory import Actions, Seen
from mbtl.contexts import Context


@dataclass(frozen=True)
class RingProblem:
    """contexts -> twin of the ring and its parameters (`mbtl.training.twin_trainer.Problem`).

    Attributes:
        actions: what is advised.
        unit: the hold at multiplier 1.
        visibility: what of the context the policy sees.
        time_limit: how the end of an episode is reported.
        obs: see `mbtl.cmdps.traffic.ring.Ring`.
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
        import jax.numpy as jnp

        import mbtl.training.jax  # noqa: F401  first: flags of jax
        from mbtl.training.jax.environments import Box, Discrete
        from mbtl.training.jax.traffic.idm import IDM
        from mbtl.training.jax.traffic.ring import RingParams, RingTwin

        advisory.check_seen(self.obs)
        speeds = self.actions == "speed"
        twin = RingTwin(
            action=Discrete(ring.LEVELS) if speeds else Box((-1.0,), (1.0,)),
            cars=ring.CARS,
            circumference=ring.CIRCUMFERENCE,
            car_length=advisory.LENGTH,
            min_gap=advisory.MIN_GAP,
            advised_min_gap=ring.CLOSEST,
            driver=IDM(advisory.ACCEL, advisory.DECEL, advisory.TAU),
            road_limit=advisory.ROAD_LIMIT,
            max_speed=advisory.MAX_SPEED,
            speed_factor=advisory.SPEED_SPREAD,
            noise=self.noise,
            dt=advisory.STEP,
            warm_up=advisory.WARM_UP,
            unmeasured=advisory.UNMEASURED,
            total_steps=advisory.UNMEASURED + advisory.MEASURED,
            reach=ring.REACH,
            top_speed=ring.TOP_SPEED,
            collision=ring.COLLISION,
            scale=ring.SCALE,
            time_limit=self.time_limit,
            stale=self.obs == "stale",
            uniform=self.start == "uniform",
        )
        params = []
        for context in contexts:
            features = full_context(ring.Ring.FEATURES, context)
            visible = visible_features(features, self.unit, self.visibility)
            hold = advisory.hold_steps(features["hold"])
            params.append(RingParams(jnp.int32(hold), jnp.asarray(visible, jnp.float32)))
        return twin, params
