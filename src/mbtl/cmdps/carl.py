"""CARL's environments as contextual MDPs of ours.

    gravities = {"GRAVITY_Y": [-10.0, -5.0, -2.0]}
    problem = carl_cmdp("CARLBipedalWalker", gravities, timesteps=1_000_000)

CARL pins Gymnasium below 1.0, so it needs an environment of its own (docs/carl.md). Its features
are not all connected to the simulator: `mbtl check` tells which act, and that page has the list.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mbtl.cmdps.cmdp import CMDP
from mbtl.contexts import Context, ContextSpace, Linear, Value
from mbtl.errors import InvalidInput, MissingExtra, unknown_name


@dataclass(frozen=True)
class CarlFactory:
    """context -> a new environment of CARL; other features keep CARL's defaults.

    Policies see the observation without the context; `CMDP.from_env` can add it.

    Attributes:
        environment: class name, e.g. "CARLCartPole".
    """

    environment: str

    def __call__(self, context: Context) -> Any:
        """A new environment.

        Raises:
            InvalidInput: CARL refuses the context.
        """
        made = _class(self.environment)
        try:
            env = made(contexts={0: dict(context)}, obs_context_features=[])
        except Exception as error:  # CARL raises of many kinds
            raise InvalidInput(
                f"{self.environment} must take the context {dict(context)}, got "
                f"{type(error).__name__}: {error}"
            ) from error
        return _without_context(env)


def carl_features(environment: str) -> dict[str, tuple[float, float, Value]]:
    """Feature -> (lowest, highest, default value), of an environment of CARL.

    Raises:
        UnknownName: CARL has no such environment, or not with what is installed.
        MissingExtra: CARL is not installed.
    """
    declared = _class(environment).get_context_features()
    return {
        name: (float(feature.lower), float(feature.upper), feature.default_value)
        for name, feature in declared.items()
        if hasattr(feature, "lower")
    }


def carl_space(environment: str, axes: Mapping[str, Sequence[float]]) -> ContextSpace:
    """The full grid over some features.

    Args:
        environment: class name.
        axes: feature -> its values, rising.

    Raises:
        UnknownName: it has no such feature.
        InvalidInput: a value lies outside the feature's range.
    """
    known = carl_features(environment)
    for name, values in axes.items():
        if name not in known:
            raise unknown_name(f"feature of {environment}", name, known)
        low, high, _ = known[name]
        if not low <= min(values) <= max(values) <= high:
            raise InvalidInput(
                f"feature {name!r} of {environment} must be from {low:g} to {high:g}, got "
                f"{min(values):g} to {max(values):g}"
            )
    return ContextSpace.grid(
        {Linear(name, min(values), max(values)): list(values) for name, values in axes.items()}
    )


def carl_cmdp(
    environment: str,
    axes: Mapping[str, Sequence[float]],
    *,
    timesteps: int,
    id: str | None = None,
    **options: Any,
) -> CMDP:
    """A problem of an environment of CARL, trained by Stable-Baselines3.

    Args:
        environment: class name, e.g. "CARLBipedalWalker".
        axes: feature -> its values, rising; the grid of them all.
        timesteps: environment steps of one training.
        id: short name; default: of environment and features.
        **options: of `CMDP.from_env`.

    Raises:
        UnknownName: no such environment or feature.
        InvalidInput: a value lies outside the feature's range.
        MissingExtra: CARL or Stable-Baselines3 is not installed.
    """
    space, known = carl_space(environment, axes), carl_features(environment)
    defaults = {name: known[name][2] for name in axes}
    inside = all(min(axes[name]) <= float(v) <= max(axes[name]) for name, v in defaults.items())
    if inside:
        options.setdefault("nominal", defaults)
    name = id or "-".join(["carl", environment.removeprefix("CARL").lower(), *map(str.lower, axes)])
    return CMDP.from_env(
        name.replace("_", "-"), space, make_env=CarlFactory(environment), timesteps=timesteps,
        **options,
    )  # fmt: skip


def _class(environment: str) -> Any:
    try:
        with warnings.catch_warnings():  # one for each of its extras that is not installed
            warnings.simplefilter("ignore")
            import carl.envs as envs
    except ImportError as error:
        raise MissingExtra(
            f"CARL is needed for {environment} and cannot be imported ({error}); install "
            "carl-bench in an environment of its own, see docs/carl.md"
        ) from error
    names = [name for name in dir(envs) if name.upper().startswith("CARL") and name != "carl"]
    if environment not in names:
        raise unknown_name("environment of CARL", environment, names)
    return getattr(envs, environment)


def _without_context(env: Any) -> Any:
    import gymnasium

    class Observed(gymnasium.ObservationWrapper):  # type: ignore[misc]  # gymnasium is untyped
        """The part of the observation that the simulator gives."""

        def __init__(self, env: Any) -> None:
            super().__init__(env)
            self.observation_space = env.observation_space["obs"]

        def observation(self, observation: Any) -> Any:
            return observation["obs"]

    return Observed(env)
