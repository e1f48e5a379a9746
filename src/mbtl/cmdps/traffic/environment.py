"""What the traffic environments share: an episode is a simulation, its score is not its return.

The return is the sum of the rewards that a policy is trained on. The score is the matrix entry
(cmdp-spec, 5-7), `info["score"]` of an episode's last step; larger is better.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

from mbtl.cmdps.contextual import ContextualEnv, TimeLimit, Visibility
from mbtl.cmdps.traffic.simulation import Engine, Simulation
from mbtl.contexts import Value

SEEDS = 2**31 - 1
"""SUMO takes seeds of 31 bits."""


class TrafficEnv(ContextualEnv):
    """A contextual environment that runs in SUMO.

    A subclass gives the network and SUMO's options and starts `self.simulation` in `reset`.

    Attributes:
        simulation: the running simulation; between episodes it is not running.
    """

    STEP: ClassVar[float]
    """Seconds of one simulation step."""

    def __init__(
        self,
        context: Mapping[str, Value] | None,
        *,
        unit: Mapping[str, float] | None,
        visibility: Visibility,
        time_limit: TimeLimit,
        horizon: int,
        engine: Engine,
        gui: bool,
    ) -> None:
        """See the subclasses for the meaning of the arguments."""
        super().__init__(
            context, unit=unit, visibility=visibility, time_limit=time_limit, horizon=horizon
        )
        self.simulation = self._simulation(engine, gui)

    def _network(self) -> Path:
        """The compiled network of this context."""
        raise NotImplementedError

    def _simulation(self, engine: Engine, gui: bool) -> Simulation:
        return Simulation(
            self._network(),
            step_length=self.STEP,
            options=self._options(),
            engine=engine,
            gui=gui,
        )

    def _options(self) -> list[str]:
        return []

    def _draw_seed(self) -> int:
        """Seed of one simulation, from the environment's own generator."""
        return int(self.np_random.integers(SEEDS))

    def _finish(self) -> None:
        """End the episode; another simulation of this process may have libsumo."""
        self._left = 0
        self.simulation.close()

    def close(self) -> None:
        """End the simulation and remove its files."""
        self._finish()
