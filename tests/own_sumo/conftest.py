"""Tests of `mbtl.sumo`. A folder called sumo would hide SUMO's own package from tools."""

import subprocess
from importlib.util import find_spec

import pytest

if not all(map(find_spec, ("gymnasium", "libsumo", "traci"))):
    collect_ignore_glob = ["test_*.py"]


FILES = {
    "own.rou.xml": """<routes>
  <vTypeDistribution id="DEFAULT_VEHTYPE">
    <vType id="truck" vClass="truck" probability="0.2"/>
    <vType id="car" tau="1.0" probability="0.4"/>
    <vType id="van" vClass="delivery" probability="0.4"/>
  </vTypeDistribution>
  <flow id="east" from="left0A0" to="A0right0" begin="0" end="3600" probability="0.2"/>
  <flow id="west" from="right0A0" to="A0left0" begin="0" end="3600" probability="0.2"/>
  <flow id="north" from="bottom0A0" to="A0top0" begin="0" end="3600" probability="0.2"/>
</routes>""",
    "own.add.xml": """<additional>
  <inductionLoop id="loop" lane="left0A0_0" pos="50" freq="60" file="out/loop.xml"/>
  <variableSpeedSign id="sign" lanes="right0A0_0" file="signs/speeds.xml"/>
</additional>""",
    "signs/speeds.xml": '<vss><step time="0" speed="13"/></vss>',
    "own.sumocfg": """<configuration>
  <input>
    <net-file value="own.net.xml"/>
    <route-files value="own.rou.xml"/>
    <additional-files value="own.add.xml"/>
  </input>
  <output><tripinfo-output value="trips.xml"/></output>
  <time><begin value="0"/><end value="300"/></time>
</configuration>""",
}


@pytest.fixture(scope="session")
def own(tmp_path_factory):
    """The `.sumocfg` of a crossing that netgenerate makes."""
    from mbtl.sumo.installed import program

    folder = tmp_path_factory.mktemp("own")
    size = ["--grid", "--grid.number", "1", "--grid.attach-length", "150"]
    lights = ["--tls.set", "A0"]
    made = [program("netgenerate"), *size, *lights, "-o", folder / "own.net.xml"]
    subprocess.run(made, check=True, capture_output=True)
    (folder / "signs").mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder / "own.sumocfg"
