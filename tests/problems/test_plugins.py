"""CMDPs of other packages: found by entry point, loaded when asked for, named when broken."""

import pytest

from mbtl.errors import InvalidInput, UnknownName
from mbtl.problems import cmdp_ids, get_cmdp, resolve_cmdp
from mbtl.problems.loading import plugin_ids
from mbtl.zoo.cli.play import play

MODULE = """
from mbtl import CMDP, ContextSpace, Linear

def make():
    return CMDP.from_functions(
        "hill-slope", ContextSpace.grid({Linear("slope", 0, 3): [0, 1, 2, 3]}),
        train=lambda context, seed: context["slope"],
        evaluate=lambda policy, contexts, seeds: [-abs(policy - c["slope"]) for c in contexts],
    )

hill, number = make(), 3
"""
POINTS = """[mbtl.cmdps]
hill-slope = hills_of_others:make
hill-ready = hills_of_others:hill
hill-number = hills_of_others:number
hill-gone = hills_of_nobody:make
cartpole-length = hills_of_others:make
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """An installed distribution, as pip leaves it."""
    (tmp_path / "hills_of_others.py").write_text(MODULE)
    info = tmp_path / "hills_of_others-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: hills-of-others\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(POINTS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)


def test_a_package_adds_cmdps_by_id(package):
    assert plugin_ids()["hill-slope"] == "hills-of-others"
    for id in ("hill-slope", "hill-ready"):
        assert get_cmdp(id).space.n == 4
        assert resolve_cmdp(id).id == "hill-slope"


def test_ours_keep_their_ids(package):
    assert get_cmdp("cartpole-length").space.n == 100
    assert "hill-slope" not in cmdp_ids()


def test_play_finds_it_and_says_what_it_lacks(package):
    with pytest.raises(InvalidInput, match="'hill-slope' is made of functions"):
        play("hill-slope")


def test_what_is_wrong_names_the_package(package):
    with pytest.raises(InvalidInput, match=r"'hills-of-others'.*ModuleNotFoundError"):
        get_cmdp("hill-gone")
    with pytest.raises(InvalidInput, match="must be a CMDP, or a function that makes one, got int"):
        get_cmdp("hill-number")
    with pytest.raises(InvalidInput, match="leave them out"):
        get_cmdp("hill-slope", visibility="hidden")
    with pytest.raises(UnknownName, match="hill-slope"):
        get_cmdp("hill-slop")


def test_commands_list_and_run_it_and_a_broken_one_hides_nothing(package, mbtl_command):
    code, out, err = mbtl_command("cmdps")
    assert (code, "hill-slope" in out, "cartpole-length" in out) == (0, True, True)
    assert "left out: CMDP 'hill-gone' of the package 'hills-of-others' cannot be loaded" in err
    assert "slope 0..3" in mbtl_command("cmdps", "hill-slope")[1]
    code, out, err = mbtl_command("run", "hill-slope", "--budget", 2, "--json")
    assert code == 0, err
