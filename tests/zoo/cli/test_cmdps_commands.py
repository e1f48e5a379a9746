import json
import sys

import pytest
import typer
from typer.testing import CliRunner

from mbtl.cli.check import check, parse_axis
from mbtl.contexts import Categorical, Linear
from mbtl.errors import CheckFailed, InvalidInput, UnknownName
from mbtl.problems import cmdp_ids, get_cmdp
from mbtl.zoo.cli.cmdps import cmdps

OWN = """
from mbtl.zoo.cmdps.cartpole import CartPole
from mbtl.problems import cmdp_ids, get_cmdp

def make_env(context):
    return CartPole(context, physics="reference")

cmdp = get_cmdp("pendulum-mass")
dead = get_cmdp("cartpole-masscart", physics="reference", visibility="hidden")
number = 3
"""


@pytest.fixture
def run():
    app = typer.Typer()
    app.command()(cmdps)
    app.command()(check)
    runner = CliRunner()

    def call(*arguments, columns=120):
        return runner.invoke(app, arguments, env={"COLUMNS": str(columns)})

    return call


@pytest.fixture
def own(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    path = tmp_path / "own_cli_problem.py"
    path.write_text(OWN)
    yield str(path)
    sys.modules.pop("own_cli_problem", None)


def test_the_list_fits_80_columns(run):
    lines = run("cmdps", columns=80).stdout.splitlines()
    assert max(map(len, lines)) <= 80
    assert not any("\N{HORIZONTAL ELLIPSIS}" in line for line in lines), "nothing is cut off"


def test_the_list_gives_each_axis_a_line(run):
    lines = run("cmdps").stdout.splitlines()
    [line] = [line for line in lines if line.startswith("pendulum-timestep")]
    fields = ["timestep", "0.005..0.5", "s", "100", "0.05", "200", "-2200..-500"]
    assert line.split() == ["pendulum-timestep", *fields]
    [first] = [i for i, line in enumerate(lines) if line.startswith("cartpole-masses-length")]
    shown = [line.split() for line in lines[first : first + 3]]
    assert shown[0][1:6] == ["masspole", "0.02..0.2", "kg", "900", "0.1"]
    assert shown[1:] == [["masscart", "0.2..2", "kg", "1"], ["length", "0.2..1", "m", "0.5"]]


def test_json_is_one_document(run):
    records = json.loads(run("cmdps", "--json").stdout)
    assert [one["id"] for one in records] == cmdp_ids()
    one = json.loads(run("cmdps", "cartpole-length", "--json").stdout)
    assert one == records[1]
    assert one["presets"]["paper"]["trainer"]["timesteps"] == 5_000_000


def test_presets_of_every_engine_are_shown(run):
    text = run("cmdps", "ring-acc").stdout
    assert "(default): K = " in text
    sumo = get_cmdp("ring-acc", engine="sumo").presets
    assert all(f"preset {name} with --engine sumo: K = " in text for name in sumo)
    signal = run("cmdps", "signal-speed").stdout
    assert signal.count("preset ") == 7
    assert signal.count("with --engine sumo-jax") == 1
    one = json.loads(run("cmdps", "ring-acc", "--json").stdout)
    assert one["presets_elsewhere"]["sumo"]["quick"]["budget"] == sumo["quick"].budget


def test_check_fails_a_dead_axis_after_showing_the_report(run, own):
    result = run("check", f"{own}:dead")
    assert isinstance(result.exception, CheckFailed)
    assert "failed" in result.stdout
    assert "11 of 12 checks hold, 1 failed" in result.stdout
    as_json = run("check", f"{own}:dead", "--json")
    assert json.loads(as_json.stdout)["ok"] is False
    assert isinstance(as_json.exception, CheckFailed)


def test_check_on_a_user_s_factory_and_problem(run, own):
    assert run("check", f"{own}:make_env", "--axis", "length=0.1:2.0:m").exit_code == 0
    two = run("check", f"{own}:make_env", "--axis", "length=0.1:2.0", "--axis", "masscart=0.5:2")
    assert isinstance(two.exception, CheckFailed)
    assert "masscart" in str(two.exception)
    assert "length" not in str(two.exception)
    assert run("check", f"{own}:cmdp").exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "error", "match"),
    [
        (("cartpole-lenght",), UnknownName, "Did you mean 'cartpole-length'"),
        (("cartpole-length", "--axis", "x=0:1"), InvalidInput, "has its axes already"),
        (("{own}:make_env",), InvalidInput, "add --axis"),
        (("{own}:number",), InvalidInput, "must be a CMDP or a function"),
        (("{own}:cmdp", "--axis", "x=0:1"), InvalidInput, "has its axes already"),
        (("{own}:make_env", "--axis", "length"), InvalidInput, "an axis is written"),
    ],
)
def test_wrong_usage_is_named(run, own, arguments, error, match):
    result = run("check", *(a.format(own=own) for a in arguments))
    assert isinstance(result.exception, error)
    assert match in str(result.exception)


def test_axes_are_read_as_written():
    assert parse_axis("length=0.1:2.0") == Linear("length", 0.1, 2.0)
    assert parse_axis("length=-1:1e3:m/s") == Linear("length", -1.0, 1000.0, "m/s")
    assert parse_axis("ground=ice, mud") == Categorical("ground", ("ice", "mud"))
    assert parse_axis("gear=1,2,3") == Categorical("gear", (1, 2, 3))
    for text in ("", "=0:1", "x", "x=", "x=1", "x=a:b", "x=2:1"):
        with pytest.raises(InvalidInput):
            parse_axis(text)
