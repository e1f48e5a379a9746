"""A crossing turned by quarters is the same crossing: what RotatedReplay rests on."""

import numpy as np
import pytest
import torch

from mbtl.zoo.cmdps.traffic.rotation import RotatedReplay, turned, turned_phase
from mbtl.zoo.cmdps.traffic.signal import APPROACHES, LEFT_LANE, Signal, _light_states


class Api:
    """Cars that stand still: one lane each, by its id."""

    def __init__(self, places):
        self.places = places
        self.lane = self.vehicle = self

    def getLastStepVehicleIDs(self, lane):
        return (lane,) if lane in self.places else ()

    def getLanePosition(self, car):
        return 750.0 - self.places[car]


def seen(places):
    """What a signal whose features are visible observes, of {lane: distance to the line}."""
    return torch.as_tensor(Signal(visibility="raw")._observe(Api(places)))[None]


@pytest.mark.parametrize("quarters", range(4))
def test_turned_cells_are_those_of_turned_cars(quarters):
    cars = {("W", 0): 5.0, ("N", LEFT_LANE): 30.0, ("N", 1): 700.0, ("S", 2): 90.0}

    def lanes(turn):
        return {
            f"{APPROACHES[(APPROACHES.index(a) + turn) % 4]}_in_{lane}": d
            for (a, lane), d in cars.items()
        }

    before, after = seen(lanes(0)), seen(lanes(quarters))
    assert before.shape == (1, 83)
    assert torch.equal(turned(before, torch.tensor([quarters])), after)
    assert torch.equal(before, after) == (quarters == 0)


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("phase", range(4))
def test_the_turned_phase_gives_green_to_the_turned_lanes(phase, quarters):
    lanes = [f"{a}_in_{lane}" for a in APPROACHES for lane in (0, LEFT_LANE)]
    states = _light_states([((lane, "", ""),) for lane in lanes])

    def green(phase):
        return {lane for lane, light in zip(lanes, states[phase], strict=True) if light == "G"}

    expected = {
        f"{APPROACHES[(APPROACHES.index(lane[0]) + quarters) % 4]}{lane[1:]}"
        for lane in green(phase)
    }
    other = int(turned_phase(torch.tensor(phase), torch.tensor(quarters)))
    assert green(other) == expected


def test_a_sample_is_a_stored_row_turned_and_every_turn_comes():
    env = Signal(visibility="hidden")
    replay = RotatedReplay(10, env.observation_space, env.action_space)
    here, there = (np.zeros((1, 80), np.float32) for _ in range(2))
    here[0, 3], there[0, 17] = 1.0, 1.0  # one car of the first approach
    replay.add(here, there, np.array([[1]]), np.array([-7.0]), np.array([False]), [{}])
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002 - the library samples by it
    rows = replay.sample(64)
    turns = rows.observations.argmax(dim=1) // 20
    assert set(turns.tolist()) == {0, 1, 2, 3}
    assert torch.equal(rows.observations.argmax(dim=1), 3 + 20 * turns)
    assert torch.equal(rows.next_observations.argmax(dim=1), 17 + 20 * turns)
    assert torch.equal(rows.actions[:, 0], 1 + 2 * (turns % 2))
    assert (rows.rewards == -7.0).all()
