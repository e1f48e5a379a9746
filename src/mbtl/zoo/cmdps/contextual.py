"""What all our environments share: context features, their visibility, and the time limit.

A *feature* is a physical constant of the simulator; a context sets some of them, the rest keep the
nominal value. The policy may see none, one or all of them (cmdp-spec, section 3):

    hidden       nothing; the gap between contexts is purely physical
    multiplier   each varied feature divided by its `unit`: 0.1..10 on the paper's grids (default)
    raw          all features in physical units, as the reference does; large values saturate tanh
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, TypedDict

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from mbtl.contexts import Value
from mbtl.errors import ContextMismatch, InvalidInput, check_known, unknown_name

Visibility = Literal["hidden", "multiplier", "raw"]
TimeLimit = Literal["truncation", "terminal"]
Observation = NDArray[np.float32]
Stepped = tuple[
    dict[str, Observation],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, dict[str, Any]],
]
"""What a PettingZoo environment gives for a step: of each agent what it sees, its reward, ..."""

VISIBILITIES: tuple[Visibility, ...] = ("hidden", "multiplier", "raw")
TIME_LIMITS: tuple[TimeLimit, ...] = ("truncation", "terminal")


class Settings(TypedDict, total=False):
    """Arguments that every environment takes beside its context; see `ContextualEnv`."""

    unit: Mapping[str, float] | None
    visibility: Visibility | None
    time_limit: TimeLimit
    horizon: int | None
    render_mode: Literal["rgb_array"] | None


class Contextual:
    """What every environment, of whichever interface, does with its context: once, at construction.

    Attributes:
        features: every feature with the value it has here.
        visible: features appended to each observation, already scaled.
    """

    FEATURES: ClassVar[Mapping[str, float]]
    """Nominal value of each feature, in the order in which `raw` shows them; all positive."""
    HIDDEN: ClassVar[frozenset[str]] = frozenset()
    """Features that a policy does not see unless a visibility is asked for."""
    HORIZON: ClassVar[int]
    """Most steps of an episode, unless another horizon is given."""

    def __init__(
        self,
        context: Mapping[str, Value] | None,
        *,
        unit: Mapping[str, float] | None,
        visibility: Visibility | None,
        time_limit: TimeLimit,
        horizon: int | None,
    ) -> None:
        """See the subclasses for the meaning of the arguments."""
        if visibility not in (None, *VISIBILITIES):
            raise unknown_name("visibility", str(visibility), VISIBILITIES)
        check_known("time limit", time_limit, TIME_LIMITS)
        horizon = self.HORIZON if horizon is None else horizon
        if horizon < 1:
            raise InvalidInput(f"horizon must be >= 1 step, got {horizon}")
        self.features = full_context(self.FEATURES, context)
        self.horizon = horizon
        if unit is None:
            unit = {name: self.FEATURES[name] for name in context or {}}
        if visibility is None:
            unit = {name: value for name, value in unit.items() if name not in self.HIDDEN}
        self.visible = visible_features(self.features, unit, visibility or "multiplier")
        self._terminal = time_limit == "terminal"
        self._left = 0  # steps left in the running episode; 0: none is running

    def _space(self, low: list[float], high: list[float]) -> Box:
        """Observation space: the physical part, then the visible features in [0, inf)."""
        n = len(self.visible)
        return Box(
            np.array(low + [0.0] * n, dtype=np.float32),
            np.array(high + [np.inf] * n, dtype=np.float32),
        )

    def _ends(self, out_of_time: bool) -> tuple[bool, bool]:
        """(terminated, truncated) as far as time decides."""
        return out_of_time and self._terminal, out_of_time and not self._terminal

    def _no_episode(self) -> InvalidInput:
        return InvalidInput(
            "step() needs a running episode, got none or one that has ended; call reset()"
        )


class ContextualEnv(Contextual, gymnasium.Env):  # type: ignore[misc]  # gymnasium is untyped for our checker
    """A Gymnasium environment whose physics is derived from a context.

    A subclass names its features, builds `observation_space` with `_space`, and writes `reset` and
    `step` in full: they run hundreds of millions of times, so there are no layers between.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(
        self,
        context: Mapping[str, Value] | None = None,
        *,
        unit: Mapping[str, float] | None = None,
        visibility: Visibility | None = "multiplier",
        time_limit: TimeLimit = "truncation",
        horizon: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Derive the features of one context.

        Args:
            context: features that differ from the nominal ones.
            unit: varied features and their value at multiplier 1; missing: those of `context`, at
                their nominal value.
            visibility: what of the context the policy sees.
            time_limit: whether the horizon is reported as truncation or as a terminal state (the
                reference).
            horizon: steps; missing: `HORIZON`.
            render_mode: "rgb_array": `render` gives pictures.
        """
        super().__init__(
            context, unit=unit, visibility=visibility, time_limit=time_limit, horizon=horizon
        )
        self.render_mode: str | None = render_mode


def full_context(
    features: Mapping[str, float], context: Mapping[str, Value] | None
) -> dict[str, float]:
    """All features: those in `context`, the nominal value for the others.

    Raises:
        UnknownName: the context names something that is no feature.
        ContextMismatch: a value is not a finite number > 0.
    """
    full = dict(features)
    for name, value in (context or {}).items():
        check_known("context feature", name, features)
        if not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0):
            raise ContextMismatch(f"feature {name!r} takes finite numbers > 0, got {value!r}")
        full[name] = float(value)
    return full


def visible_features(
    features: Mapping[str, float], unit: Mapping[str, float], visibility: Visibility
) -> tuple[float, ...]:
    """The numbers appended to an observation.

    Args:
        features: every feature of the environment.
        unit: varied features and their value at multiplier 1.
        visibility: what the policy may see.

    Raises:
        UnknownName: `unit` names something that is no feature.
    """
    for name in unit:
        check_known("context feature", name, features)
    if visibility == "hidden":
        return ()
    if visibility == "raw":
        return tuple(features.values())
    return tuple(features[name] / unit[name] for name in unit)
