"""One simulation at a time in this process; everything else goes to a process of its own."""

import copy
import os
import pickle
import signal
import subprocess
import sys

import pytest

from mbtl.errors import InvalidInput, MissingExtra, SimulationFailed, UnknownName
from mbtl.sumo import Simulation, network
from mbtl.sumo import installed as sumo

ROAD = {
    "nodes": '<nodes><node id="a" x="0" y="0"/><node id="b" x="500" y="0"/></nodes>',
    "edges": '<edges><edge id="ab" from="a" to="b" numLanes="1" speed="14"/></edges>',
}
ROUTES = """<routes><vType id="car" sigma="0.5"/>
  <vehicle id="one" type="car" depart="0"><route edges="ab"/></vehicle></routes>"""


@pytest.fixture(scope="module")
def road():
    return ["--net-file", str(network(ROAD))]


@pytest.fixture
def make(road, opened):
    return lambda **options: opened(Simulation(road, **options))


def speeds(simulation, steps=10):
    with simulation.guard() as api:
        seen = []
        for _ in range(steps):
            api.simulationStep()
            seen.append(api.vehicle.getSpeed("one"))
    return seen


def test_both_engines_give_the_same_numbers_and_run_side_by_side(make):
    first, second, third = make(), make(), make(engine="libsumo")
    first.start(ROUTES, seed=5)
    second.start(ROUTES, seed=5)
    assert (first.running, second.running) == ("libsumo", "traci")
    with pytest.raises(SimulationFailed, match="one simulation per process"):
        third.start(ROUTES, seed=0)
    found, folder = speeds(first), first._folder
    assert found == speeds(second)
    first.start(ROUTES, seed=6)
    assert speeds(first) != found
    first.close()
    assert not folder.exists()  # generated files go with the simulation
    third.start(ROUTES, seed=5)
    assert (third.running, speeds(third)) == ("libsumo", found)


def test_a_forgotten_simulation_frees_libsumo(road, make):
    Simulation(road).start(ROUTES, seed=0)
    other = make()
    other.start(ROUTES, seed=0)
    assert other.running == "libsumo"


def test_a_simulation_has_no_copies(make):
    """A copy would speak for the same simulation, and end it with itself."""
    simulation = make()
    simulation.start(ROUTES, seed=0)
    for copied in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match="cannot be copied"):
            copied(simulation)
    assert speeds(simulation)


def test_bad_input_of_sumo_is_one_sentence_and_the_next_start_works(make):
    simulation = make()
    with pytest.raises(SimulationFailed, match="nowhere"):
        simulation.start(ROUTES.replace('edges="ab"', 'edges="nowhere"'), seed=0)
    assert simulation.running is None
    simulation.start(ROUTES, seed=0)
    with pytest.raises(SimulationFailed, match="two"), simulation.guard() as api:
        api.vehicle.getSpeed("two")
    simulation.start(ROUTES, seed=0)
    assert speeds(simulation)


def test_a_simulator_that_is_killed_is_an_error_and_can_be_started_again(make):
    simulation = make(engine="traci")
    simulation.start(ROUTES, seed=0)
    os.kill(simulation.api._process.pid, signal.SIGKILL)
    with pytest.raises(SimulationFailed, match="has stopped"):
        speeds(simulation)
    simulation.start(ROUTES, seed=0)
    assert speeds(simulation)


def test_netconvert_says_what_is_wrong():
    with pytest.raises(SimulationFailed, match="netconvert"):
        network({**ROAD, "edges": '<edges><edge id="ab" from="a" to="z"/></edges>'})


def test_a_missing_or_old_sumo_names_the_fix(monkeypatch):
    with pytest.raises(MissingExtra, match=r"SUMO 1\.16\.0"):
        sumo.check_version("SUMO 1.16.0")
    sumo.check_version("SUMO 1.28.0")
    with pytest.raises(MissingExtra, match=r"pip install 'mbtl\[traffic\]'"):
        sumo.program("no-such-program-of-sumo")
    with pytest.raises(MissingExtra, match="traffic"):
        sumo.library("no_such_library_of_sumo")


def unloadable(monkeypatch, *names):
    """The named libraries are installed but lack a library of the machine."""
    load = sumo.importlib.import_module

    def fail(name):
        library = name.partition(".")[0]
        if library in names:
            raise ImportError(f"{library} wants libGL.so.1", name=library)
        return load(name)

    monkeypatch.setattr(sumo.importlib, "import_module", fail)


def test_traci_serves_where_libsumo_cannot_be_loaded_and_says_so_once(make, monkeypatch, caplog):
    inside = make()
    inside.start(ROUTES, seed=3)
    expected = speeds(inside)
    inside.close()
    unloadable(monkeypatch, "libsumo")
    other = make()
    other.start(ROUTES, seed=3)
    assert other.running == "traci"
    assert speeds(other) == expected
    other.start(ROUTES, seed=4)
    assert [record.message for record in caplog.records if "slower" in record.message] == [
        "TraCI serves instead of libsumo, slower: libsumo is installed but must be loadable, got: "
        "libsumo wants libGL.so.1; install what it names"
    ]


def test_without_either_library_the_reason_is_told(make, monkeypatch):
    unloadable(monkeypatch, "libsumo", "traci")
    with pytest.raises(MissingExtra, match=r"libsumo wants libGL\.so\.1"):
        make().start(ROUTES, seed=0)
    busy = make()
    monkeypatch.undo()
    busy.start(ROUTES, seed=0)
    unloadable(monkeypatch, "libsumo", "traci")
    with pytest.raises(MissingExtra, match=r"traci wants libGL\.so\.1"):
        make().start(ROUTES, seed=0)


def test_an_old_sumo_is_refused_at_the_start_and_not_left_running(make, monkeypatch):
    simulation = make()
    with monkeypatch.context() as patch:
        patch.setattr("mbtl.sumo.installed.OLDEST", (99, 0))
        with pytest.raises(MissingExtra, match=r"99\.0 or newer, got"):
            simulation.start(ROUTES, seed=0)
        assert simulation.running is None
    simulation.start(ROUTES, seed=0)
    assert speeds(simulation)


def test_a_window_is_sumo_gui_through_traci_and_starts_by_itself(make, monkeypatch):
    from traci import main as traci

    asked = []
    start = traci.start

    def watched(command, **options):
        asked.append(command)
        program = command[0].replace("sumo-gui", "sumo")  # the rest is real; there is no screen
        return start([program, *(word for word in command[1:] if word != "--start")], **options)

    monkeypatch.setattr(traci, "start", watched)
    monkeypatch.setenv("DISPLAY", ":0")
    simulation = make(gui=True)
    simulation.start(ROUTES, seed=3)
    assert simulation.running == "traci"
    assert asked[0][0].endswith("sumo-gui")
    assert "--start" in asked[0]
    assert speeds(simulation)


def test_settings_are_checked(road, monkeypatch):
    with pytest.raises(UnknownName, match="libsumo"):
        Simulation(road, engine="libsum")
    with pytest.raises(InvalidInput, match="TraCI"):
        Simulation(road, engine="libsumo", gui=True)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(InvalidInput, match="screen"):
        Simulation(road, gui=True)


def test_traci_is_the_installed_one_that_talks_to_another_process(tmp_path):
    (tmp_path / "traci").mkdir()
    (tmp_path / "traci" / "__init__.py").write_text("raise ImportError('of another SUMO')")
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    disturbed = {"PYTHONPATH": path, "LIBSUMO_AS_TRACI": "1"}
    code = (
        "from mbtl.sumo.installed import library\n"
        "print(library('traci').start.__module__, library('libsumo').__name__)\n"
    )
    command, env = [sys.executable, "-c", code], {**os.environ, **disturbed}
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["traci.main", "libsumo"], done.stderr
