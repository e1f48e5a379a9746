"""Contextual MDPs from a scenario of SUMO's, or from an environment of sumo-rl's."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium

from mbtl.contexts import Context, ContextSpace
from mbtl.errors import MissingExtra
from mbtl.problems import CMDP
from mbtl.score import Score
from mbtl.settings import described
from mbtl.sumo.environment import METRICS, KeepOrGoOn, Measured, ScenarioEnv, arguments
from mbtl.sumo.installed import program
from mbtl.sumo.scenario import Change, Scenario


def from_sumocfg(
    id: str,
    config: str | os.PathLike[str],
    space: ContextSpace,
    changes: Mapping[str, Change],
    *,
    lights: str | Sequence[str] = (),
    control: Callable[..., Any] = KeepOrGoOn,
    decision: float = 5.0,
    seconds: float | None = None,
    **record: Any,
) -> CMDP:
    """A problem from a scenario of your own, whose traffic lights are to be controlled.

    Args:
        id: short name, part of file names.
        config: a `.sumocfg`. Its files are only read.
        space: the contexts.
        changes: by name of an axis, what it changes in the scenario, e.g. `Demand()`.
        lights: names of the lights to control; none: all.
        control: what a policy sees, does and is rewarded for; see `KeepOrGoOn`.
        decision: seconds of one decision.
        seconds: of an episode; None: from the scenario's begin to its end.
        **record: further arguments of `mbtl.CMDP.from_env`: `timesteps`, and e.g. `algorithm`. As
            it stands the score is the delay, minimised.

    Raises:
        UnknownName: the scenario has no such light, element or attribute.
        InvalidInput: a file cannot be read, or the network has no light.
    """
    scenario = Scenario.read(config, changes)
    lights = [lights] if isinstance(lights, str) else lights
    chosen = partial(control, lights=tuple(lights)) if lights else control
    make_env = partial(
        ScenarioEnv, scenario=scenario, control=chosen, decision=decision, seconds=seconds
    )
    told = {"lights": [*lights], "decision": decision, "seconds": seconds}
    horizon = make_env(space.context(0)).episode_steps
    record = {"horizon": horizon, **_standard(scenario, space, told), **record}
    return CMDP.from_env(id, space, make_env=make_env, **record)


def from_sumo_rl(
    id: str,
    net_file: str,
    route_file: str,
    space: ContextSpace,
    changes: Mapping[str, Change],
    options: Mapping[str, Any],
    **record: Any,
) -> CMDP:
    """A problem from `sumo_rl.SumoEnvironment` with a single agent.

    Args:
        id: short name, part of file names.
        net_file: network.
        route_file: vehicles.
        space: the contexts.
        changes: by name of an axis, what it changes in the files, e.g. `Demand()`.
        options: further arguments of `sumo_rl.SumoEnvironment`, e.g. `num_seconds`.
        **record: as of `from_sumocfg`.

    Raises:
        MissingExtra: sumo-rl is not installed.
        UnknownName: the files have no such element or attribute.
        InvalidInput: a file cannot be read.
    """
    if find_spec("sumo_rl") is None:
        raise MissingExtra("sumo-rl is needed for this and not installed; run: pip install sumo-rl")
    places = map(os.path.abspath, (net_file, route_file))
    scenario = Scenario(dict(zip(("net-file", "route-files"), places, strict=True)), dict(changes))
    make_env = partial(SumoRLEnv, scenario=scenario, options=dict(options))
    record = {**_standard(scenario, space, described(options)), **record}
    return CMDP.from_env(id, space, make_env=make_env, **record)


class SumoRLEnv(gymnasium.Wrapper):  # type: ignore[misc]  # gymnasium is untyped for our checker
    """`sumo_rl.SumoEnvironment` in one context; its last `info` tells `METRICS`, too."""

    def __init__(self, context: Context, scenario: Scenario, options: Mapping[str, Any]) -> None:
        """Arguments as of `from_sumo_rl`."""
        os.environ.setdefault("SUMO_HOME", str(Path(program("sumo")).parents[1]))
        self._measured = Measured()
        files = scenario.files(context).write(self._measured.folder) | self._measured.options
        net, routes = files.pop("net-file"), files.pop("route-files")
        more = " ".join([options.get("additional_sumo_cmd") or "", *arguments(files)])
        given = {**options, "additional_sumo_cmd": more, "single_agent": True}
        super().__init__(importlib.import_module("sumo_rl").SumoEnvironment(net, routes, **given))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin with a new seed; sumo-rl's own would be that of the episode before."""
        seed = int(self.np_random.integers(2**31)) if seed is None else seed % 2**31
        seen, info = self.env.reset(seed=seed, options=options)
        return seen, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """As sumo-rl's."""
        seen, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            seconds = self.env.sim_step - self.env.begin_time
            self.env.close()  # SUMO writes what it has measured
            info = {**info, **self._measured.metrics(seconds)}
        return seen, reward, terminated, truncated, info

    def close(self) -> None:
        """End the simulation and remove its files."""
        super().close()
        self._measured.close()


def _standard(scenario: Scenario, space: ContextSpace, told: Mapping[str, Any]) -> dict[str, Any]:
    """What a record holds unless a user says otherwise, of a scenario that fits the axes."""
    scenario.check(space)
    return {
        "score": Score("delay", unit=METRICS["delay"], direction="minimize"),
        "metrics": {name: unit for name, unit in METRICS.items() if name != "delay"},
        "settings": {**told, "changes": described(scenario.changes)},
        "trainer_options": {"n_eval_envs": 1},  # libsumo holds one simulation per process
    }
