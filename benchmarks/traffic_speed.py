"""Simulation steps per second of ring, ramp and signal: SUMO alone, and what our calls cost.

Each line adds calls to the same traffic: SUMO alone (`simulationStep` in a loop, or in one call),
the drivers' noise and the score, then observation and control: what `step` does. Ratios are to SUMO
alone, in processor time of one run. Advice is to keep one's speed; the signal has fixed times and
its episodes run to their end. Decisions take 1 s (ring, ramp) and 10 to 14 s (signal).

example: python benchmarks/traffic_speed.py
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import measure
from fixed_advice import PHASES
from measure import cost_of, digits, median, note


class Ring:
    """22 cars; the steps after the warm-up."""

    name, cars = "ring", "22 cars"

    def __init__(self, seconds: int) -> None:
        """Args: seconds of one round."""
        from mbtl.zoo.cmdps.traffic.ring import RingAcc

        self.seconds, self.make = seconds, RingAcc

    def layers(self) -> dict[str, Callable[[], Callable[[], None]]]:
        """Functions by name, each of which prepares the work of one round."""
        return {
            "SUMO alone": partial(self.prepare, 0.0, self.alone),
            "and noise": partial(self.prepare, 0.2, self.noisy),
            "step, no noise": partial(self.prepare, 0.0, self.whole),
            "step": partial(self.prepare, 0.2, self.whole),
        }

    def prepare(self, noise: float, work: Callable[[Any], None]) -> Callable[[], None]:
        """A round after a fresh reset."""
        env = self.make({"hold": 1.0}, noise=noise)
        env.reset(seed=0)

        def run() -> None:
            work(env)
            env.close()

        return run

    def alone(self, env: Any) -> None:
        """Nothing but the simulator."""
        for _ in range(10 * self.seconds):
            env.simulation.api.simulationStep()

    def noisy(self, env: Any) -> None:
        """Speeds read and disturbed, nothing observed or advised."""
        api = env.simulation.api
        for _ in range(10 * self.seconds):
            api.simulationStep()
            env._drivers.step(api, api.vehicle.getIDList(), ())

    def whole(self, env: Any) -> None:
        """Observation, control, measures."""
        for _ in range(self.seconds):
            env.step([0.0])

    def steps(self) -> int:
        """Simulation steps of a round."""
        return 10 * self.seconds


class Ramp(Ring):
    """About 70 cars; a tenth of those on the main road are advised."""

    name, cars = "ramp", "about 70 cars"

    def __init__(self, seconds: int) -> None:
        """As the ring."""
        from mbtl.zoo.cmdps.traffic.ramp import RampAcc

        self.seconds, self.make = seconds, RampAcc

    def whole(self, env: Any) -> None:
        """Every agent is told to keep its speed."""
        for _ in range(self.seconds):
            env.step({car: [0.0] for car in env.agents})


class Signal:
    """Whole episodes of 5400 s."""

    name, cars = "signal", "1,000 cars per episode"

    def __init__(self, seconds: int) -> None:
        """The length of an episode is given."""
        from mbtl.zoo.cmdps.traffic import signal

        self.signal = signal

    def layers(self) -> dict[str, Callable[[], Callable[[], None]]]:
        """As the ring's; there is no noise of ours."""
        return {
            "SUMO alone": partial(self.prepare, watched=False),
            "step": partial(self.prepare, watched=True),
        }

    def prepare(self, watched: bool) -> Callable[[], None]:
        """An episode with fixed times."""
        env = self.signal.Signal()
        env.reset(seed=0)

        def run() -> None:
            decision, last = 0, None
            while env._time < self.signal.SECONDS:
                phase = PHASES[decision % len(PHASES)]
                decision += 1
                if watched:
                    env.step(phase)
                    if env.simulation.running is None:
                        break
                    continue
                api = env.simulation.api  # the lights only
                if last not in (None, phase):
                    env._show(api, env._states[last].replace("G", "y"), self.signal.YELLOW)
                env._show(api, env._states[phase], self.signal.GREEN)
                last = phase
            env.close()

        return run

    def steps(self) -> int:
        """Simulation steps of a round."""
        return int(self.signal.SECONDS)


def main() -> None:
    """Measure and print."""
    parser = measure.parser(__doc__)
    parser.add_argument("--seconds", type=int, default=120, help="simulated per round (not signal)")
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    lines = ["simulation steps per second of processor time, and the share of SUMO alone"]
    results: dict[str, dict[str, Any]] = {}
    for kind in (Ring, Ramp, Signal):
        scenario = kind(args.seconds)
        note(f"{scenario.name} ...")
        rates: dict[str, float] = {}
        for layer, prepare in scenario.layers().items():
            costs = [cost_of(prepare()) for _ in range(args.rounds)]
            rates[layer] = digits(scenario.steps() / median(costs).cpu, 3)
        results[scenario.name] = rates
        lines.append(f"  {scenario.name}, {scenario.cars}")
        alone = rates["SUMO alone"]
        lines += [f"    {k:16}{r:9.0f}   {r / alone:5.2f}" for k, r in rates.items()]
    document = {
        "seconds": args.seconds,
        "rounds": args.rounds,
        "steps_per_second": results,
        "machine": measure.machine("libsumo"),
    }
    measure.show(document, lines, as_json=args.json)


if __name__ == "__main__":
    main()
