"""The eco-driving road: two feeders, a ghost signal, an approach, a box, an exit (cmdp-spec, 6.1).

Everything is one lane. AB brings nine tenths of the cars straight on, AA the others from the side;
the ghost signal lets one of them at a time into the region where cars are controlled:

    AB 246 m  \
               ghost | approach 235.6 m | signal | box 14.4 m | exit 235.6 m |
    AA 242.8 m /     0                  235.6             250                485.6   position [m]

The junctions have no length of their own: the box is a road, and a car passes from the end of one
road to the start of the next. Cars of AA do not slow down for their turn, and none waits at a green
light for space behind it (SUMO's keepClear is off).

Both signals have the cycle green g, yellow 3 s, red 35 s, yellow 3 s, from time 0. The main signal
is red in the last two; the ghost gives AB the first two and AA the last two.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from mbtl.cmdps.traffic.networks import network
from mbtl.errors import ContextMismatch

APPROACH, BOX, EXIT = 235.6, 14.4, 235.6
FEEDERS = {"AB": 246.0, "AA": 242.8}
"""Lengths [m]."""
SHARES = {"AB": 0.9, "AA": 0.1}
"""Of the inflow."""
LIMIT = 14.0
"""Speed limit everywhere [m/s]."""
YELLOW, RED = 3.0, 35.0
STEP = 0.5
"""Seconds of one simulation step."""

ROADS = ("approach", "box", "exit")
"""The controlled region, in the direction of travel."""
STARTS = (0.0, APPROACH, APPROACH + BOX)
"""Position of the start of each [m]."""
LENGTH = APPROACH + BOX + EXIT
"""Of the region [m]."""

_SHORTEST = 1.0


class Light(NamedTuple):
    """The main signal; seconds."""

    green: float

    @property
    def cycle(self) -> float:
        """Time from green to green."""
        return self.green + YELLOW + RED + YELLOW

    def phase(self, time: float) -> int:
        """0 green, 1 yellow, 2 red: what cars obey in the step that begins at `time`."""
        within = time % self.cycle
        return 0 if within < self.green else 1 if within < self.green + YELLOW else 2

    def changes(self, time: float) -> tuple[float, float, float]:
        """Seconds from `time` until green next begins or ends, and the two changes after."""
        within = time % self.cycle
        end, start = self.green - within, self.cycle - within
        if end > 0:
            return end, start, end + self.cycle
        return start, end + self.cycle, start + self.cycle


def light(green: float) -> Light:
    """The signal with this green.

    Raises:
        ContextMismatch: less than 1 s, or no multiple of the simulation step, on which SUMO would
            let the signals drift.
    """
    steps = green / STEP
    if not (math.isfinite(green) and green >= _SHORTEST and steps == round(steps)):
        raise ContextMismatch(
            f"green lasts at least {_SHORTEST:g} s, in multiples of {STEP} s, got {green!r}"
        )
    return Light(green)


def corridor(light: Light) -> Path:
    """The compiled network with both signals."""
    west, south = FEEDERS["AB"], FEEDERS["AA"]
    nodes = "".join(
        f'<node id="{id}" x="{x:g}" y="{y:g}" type="{kind}"/>'
        for id, x, y, kind in (
            ("west", -west, 0.0, "priority"),
            ("south", 0.0, -south, "priority"),
            ("ghost", 0.0, 0.0, "traffic_light"),
            ("main", APPROACH, 0.0, "traffic_light"),
            ("middle", APPROACH + BOX, 0.0, "priority"),
            ("end", LENGTH, 0.0, "priority"),
        )
    )
    edges = "".join(
        f'<edge id="{id}" from="{a}" to="{b}" numLanes="1" speed="{LIMIT:g}" length="{length:g}"/>'
        for id, a, b, length in (
            ("AB", "west", "ghost", west),
            ("AA", "south", "ghost", south),
            ("approach", "ghost", "main", APPROACH),
            ("box", "main", "middle", BOX),
            ("exit", "middle", "end", EXIT),
        )
    )
    links = "".join(
        f'<connection from="{a}" to="{b}" fromLane="0" toLane="0" keepClear="0"/>'
        for a, b in (
            ("AB", "approach"),
            ("AA", "approach"),
            ("approach", "box"),
            ("box", "exit"),
        )
    )
    return network(
        {
            "nodes": f"<nodes>{nodes}</nodes>",
            "edges": f"<edges>{edges}</edges>",
            "connections": f"<connections>{links}</connections>",
            "lights": f"<tlLogics>{_programs(light)}</tlLogics>",
        },
        "--no-internal-links",
    )


def _programs(light: Light) -> str:
    """Links of the ghost go clockwise from the south: AA, then AB."""
    seconds = (light.green, YELLOW, RED, YELLOW)
    programs = {"ghost": ("rG", "ry", "Gr", "yr"), "main": ("G", "y", "r", "r")}
    return "".join(
        f'<tlLogic id="{id}" programID="0" offset="0" type="static">'
        + "".join(
            f'<phase duration="{duration:g}" state="{state}"/>'
            for duration, state in zip(seconds, states, strict=True)
        )
        + "</tlLogic>"
        for id, states in programs.items()
    )
