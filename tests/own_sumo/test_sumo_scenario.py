"""A context changes a copy of the user's files, and SUMO takes it."""

import gzip
import re
from functools import partial
from xml.etree import ElementTree

import pytest
from played import played

import mbtl
from mbtl import sumo
from mbtl.errors import InvalidInput, UnknownName
from mbtl.sumo.scenario import Files, Scenario

IN_ROUTES, IN_NET = (partial(sumo.Attribute, f"own.{kind}.xml") for kind in ("rou", "net"))
CHANGES = {
    "demand": (sumo.Demand(), 1.0, 2.0),
    "limit": (sumo.SpeedLimit(), 1.0, 0.5),
    "yellow": (sumo.PhaseDuration("A0", 1), 3.0, 6.0),
    "trucks": (sumo.TypeShare("truck"), 0.0, 1.0),
    "gap": (IN_ROUTES("vType[@id='car']", "tau"), 1.0, 3.0),
    "east": (IN_ROUTES("flow[@id='east']", "probability", multiply=True), 1.0, 0.2),
    "crossing": (IN_NET("edge[@id='left0A0']/lane", "speed", multiply=True), 1.0, 0.3),
}


def space_of(*names):
    ends = {name: CHANGES[name][1:] for name in names}
    return mbtl.ContextSpace.grid(
        {mbtl.Linear(name, min(two), max(two), unit="1"): sorted(two) for name, two in ends.items()}
    )


def scenario(config, *names):
    return Scenario.read(config, {name: CHANGES[name][0] for name in names})


def rollout(config, name, value, opened):
    """What is seen in two minutes in which a light goes on whenever it may."""
    env = opened(sumo.ScenarioEnv({name: value}, scenario(config, name), seconds=120))
    first, _ = env.reset(seed=7)
    outcomes = played(lambda: env.step(1))
    env.close()
    return [first.tolist(), *(one[0].tolist() for one in outcomes)], outcomes[-1][4]


@pytest.mark.parametrize("name", CHANGES)
def test_every_kind_of_axis_changes_a_seeded_rollout(name, own, opened):
    _, one, other = CHANGES[name]
    before = rollout(own, name, one, opened)
    assert before == rollout(own, name, one, opened)
    after = rollout(own, name, other, opened)
    assert before[0] != after[0]
    assert before[1] != after[1]


def test_the_nominal_values_change_nothing(own, opened):
    """Demand, limits, the phase and a factor of 1 are what the files say themselves."""
    files = [rollout(own, name, 1.0, opened) for name in ("demand", "limit", "east")]
    assert files[0] == files[1] == files[2] == rollout(own, "yellow", 3.0, opened)


def test_the_users_files_stay_as_they_are_and_nothing_is_written_beside_them(own, opened):
    folder = own.parent
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    for name in ("limit", "trucks", "yellow"):
        rollout(own, name, CHANGES[name][2], opened)
    assert before == {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_additional_files_read_is_found_and_what_they_write_goes_elsewhere(own, tmp_path):
    options = scenario(own, "demand").files({"demand": 1.0}).write(tmp_path)
    copy = ElementTree.parse(options["additional-files"]).getroot()
    assert copy.find("inductionLoop").get("file") == "loop.xml"
    assert copy.find("variableSpeedSign").get("file") == str(own.parent / "signs" / "speeds.xml")
    assert options["net-file"] == str(own.parent / "own.net.xml")  # it is used where it is


def test_a_configuration_is_read_as_sumo_reads_it(own, tmp_path):
    short = tmp_path / "short.sumocfg"
    routes = tmp_path / "own.rou.xml.gz"
    routes.write_bytes(gzip.compress((own.parent / "own.rou.xml").read_bytes()))
    short.write_text(
        f'<configuration><n value="{own.parent}/own.net.xml"/><r v=" own.rou.xml.gz"/>'
        '<b value="8:00:00"/><e value="8:01:30"/><scale value="2"/><random value="true"/>'
        '<gui_only><osg-view value="true"/></gui_only><log value="x.txt"/>'
        '<human-readable-time value="true"/></configuration>'
    )
    found = Scenario.read(short, {"demand": sumo.Demand(), "trucks": sumo.TypeShare("truck")})
    assert found.seconds == 90.0
    files = found.files({"demand": 1.5, "trucks": 0.25})
    options = files.write(tmp_path)
    assert options.pop("net-file") == str(own.parent / "own.net.xml")
    written = ElementTree.parse(options.pop("route-files"))
    assert options == {"begin": "8:00:00", "end": "8:01:30", "scale": "3"}
    weights = [float(one.get("probability")) for one in written.iter("vType")]
    assert weights == [0.25, 0.375, 0.375]  # truck; car and van had the same


@pytest.mark.parametrize(
    ("change", "error", "told"),
    [
        (sumo.PhaseDuration("A1", 0), UnknownName, "Did you mean .*A0"),
        (sumo.PhaseDuration("A0", 4), InvalidInput, "'A0' has phases 0 to 3, got 4"),
        (sumo.TypeShare("trukc"), UnknownName, "Did you mean 'truck'"),
        (sumo.Attribute("own.rou.xm", "flow", "end"), UnknownName, "Did you mean 'own.rou.xml'"),
        (IN_ROUTES("flwo", "end"), UnknownName, "Did you mean 'flow'"),
        (IN_ROUTES("flow[@id='eats']", "end"), UnknownName, r"mean \"flow\[@id='east'\]\""),
        (IN_ROUTES("flow[", "end"), UnknownName, "Its elements are flow, "),
        (IN_ROUTES("flow", "probabilty"), UnknownName, "attribute of <flow> .*mean 'probability'"),
        (IN_ROUTES("flow", "from", multiply=True), InvalidInput, "are multiplied, got 'left0A0'"),
    ],
)
def test_what_the_scenario_does_not_have_is_one_sentence_at_construction(change, error, told, own):
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 2})
    with pytest.raises(error, match=told) as raised:
        sumo.from_sumocfg("own", own, space, {"x": change}, timesteps=100)
    assert "\n" not in str(raised.value)


def test_axes_lights_and_times_are_checked_at_construction(own, tmp_path):
    endless, dark = tmp_path / "endless.sumocfg", tmp_path / "dark.sumocfg"
    endless.write_text(re.sub("<end .*?/>", "", own.read_text()))
    for path in own.parent.iterdir():
        (tmp_path / path.name).exists() or (tmp_path / path.name).symlink_to(path)
    nodes = '<nodes><node id="a" x="0" y="0"/><node id="b" x="99" y="0"/></nodes>'
    road = sumo.network({"nodes": nodes, "edges": '<edges><edge id="ab" from="a" to="b"/></edges>'})
    dark.write_text(f'<configuration><net-file value="{road}"/><end value="9"/></configuration>')
    demand = space_of("demand")
    for config, space, more, error, words in (
        (own, space_of("limit"), {}, InvalidInput, "each axis has a change of its name"),
        (own, demand, {"lights": ["A1"]}, UnknownName, "Did you mean 'A0'"),
        (tmp_path / "no", demand, {}, InvalidInput, "a scenario needs XML files"),
        (endless, demand, {}, InvalidInput, "give seconds"),
        (own, demand, {"decision": 0}, InvalidInput, "a decision takes seconds > 0, got 0"),
        (dark, demand, {}, InvalidInput, "needs a network with traffic lights"),
    ):
        with pytest.raises(error, match=words):
            sumo.from_sumocfg("x", config, space, {"demand": sumo.Demand()}, timesteps=9, **more)


def test_a_speed_limit_is_a_factor_and_no_speed_and_a_share_is_one(own):
    with pytest.raises(InvalidInput, match="0 to 1, got 2"):
        scenario(own, "trucks").files({"trucks": 2.0})
    with pytest.raises(InvalidInput, match="needs a vTypeDistribution in the demand, got none"):
        sumo.TypeShare("truck").apply(Files({}), 0.5)
    files = Files({"net-file": str(own.with_name("own.net.xml"))})
    with pytest.raises(InvalidInput, match=r"SpeedLimit takes a factor, got 20\.0"):
        sumo.SpeedLimit().apply(files, 20.0)
