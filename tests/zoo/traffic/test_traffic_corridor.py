import pytest

pytest.importorskip("libsumo")

from mbtl.errors import ContextMismatch
from mbtl.zoo.cmdps.traffic.eco import APPROACH, BOX, EXIT, LENGTH, corridor, light
from mbtl.zoo.cmdps.traffic.simulation import Simulation


def test_the_signal_is_green_yellow_and_red_in_turn():
    signal = light(35.0)
    assert signal.cycle == 76.0
    assert [signal.phase(t) for t in (0.0, 34.5, 35.0, 37.5, 38.0, 75.5, 76.0)] == [
        *(0, 0, 1, 1, 2, 2, 0)
    ]


def test_changes_count_down_to_the_ends_and_begins_of_green():
    signal = light(35.0)
    assert signal.changes(0.0) == (35.0, 76.0, 111.0)
    assert signal.changes(34.5) == (0.5, 41.5, 76.5)
    assert signal.changes(35.0) == (41.0, 76.0, 117.0)
    assert signal.changes(76.0 + 75.0) == (1.0, 36.0, 77.0)


@pytest.mark.parametrize("green", [0.0, 0.5, 12.3, float("nan"), float("inf")])
def test_a_green_that_no_signal_can_show_is_refused(green):
    with pytest.raises(ContextMismatch, match="at least 1 s"):
        light(green)


@pytest.mark.parametrize("green", [1.0, 12.5, 35.0])
def test_sumo_shows_what_the_signal_says(green):
    signal = light(green)
    simulation = Simulation(corridor(signal), step_length=0.5)
    simulation.start("<routes/>", 0)
    with simulation.guard() as api:
        state = api.trafficlight.getRedYellowGreenState
        links = api.trafficlight.getControlledLinks("ghost")
        straight = [link[0][0] for link in links].index("AB_0")
        for k in range(400):
            api.simulationStep()  # shows the state that its cars have obeyed
            phase = signal.phase(0.5 * k)
            assert "Gyr".index(state("main")) == phase
            ghost = state("ghost")
            assert "Gyr".index(ghost[straight]) == phase  # AB has the main signal's green
            within = 0.5 * k % signal.cycle - green - 3.0
            side = 0 if 0 <= within < 35 else 1 if within >= 35 else 2
            assert "Gyr".index(ghost[1 - straight]) == side
        lengths = [api.lane.getLength(f"{road}_0") for road in ("approach", "box", "exit")]
    simulation.close()
    assert lengths == pytest.approx([APPROACH, BOX, EXIT])
    assert pytest.approx(485.6) == LENGTH
