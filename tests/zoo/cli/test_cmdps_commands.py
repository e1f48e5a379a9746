import json

import pytest

from mbtl.problems import cmdp_ids, get_cmdp
from mbtl.zoo.cmdps.cartpole import CartPole


def make_env(context):
    return CartPole(context, physics="reference")


cmdp = get_cmdp("pendulum-mass")
dead = get_cmdp("cartpole-masscart", physics="reference", visibility="hidden")
number = 3


def test_the_list_fits_80_columns(mbtl_command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    lines = mbtl_command("cmdps")[1].splitlines()
    assert max(map(len, lines)) <= 80
    assert not any("\N{HORIZONTAL ELLIPSIS}" in line for line in lines), "nothing is cut off"


def test_the_list_gives_each_axis_a_line(mbtl_command):
    lines = mbtl_command("cmdps")[1].splitlines()
    [line] = [line for line in lines if line.startswith("pendulum-timestep")]
    fields = ["timestep", "0.005..0.5", "s", "100", "0.05", "200", "-2200..-500"]
    assert line.split() == ["pendulum-timestep", *fields]
    [first] = [i for i, line in enumerate(lines) if line.startswith("cartpole-masses-length")]
    shown = [line.split() for line in lines[first : first + 3]]
    assert shown[0][1:6] == ["masspole", "0.02..0.2", "kg", "900", "0.1"]
    assert shown[1:] == [["masscart", "0.2..2", "kg", "1"], ["length", "0.2..1", "m", "0.5"]]


def test_json_is_one_document(mbtl_command):
    records = mbtl_command.document("cmdps")
    assert [one["id"] for one in records] == cmdp_ids()
    one = mbtl_command.document("cmdps", "cartpole-length")
    assert one == records[1]
    assert one["presets"]["paper"]["trainer"]["timesteps"] == 5_000_000


def test_presets_of_every_engine_are_shown(mbtl_command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    text = mbtl_command("cmdps", "ring-acc")[1]
    assert "(default): K = " in text
    sumo = get_cmdp("ring-acc", engine="sumo").presets
    assert all(f"preset {name} with --engine sumo: K = " in text for name in sumo)
    signal = mbtl_command("cmdps", "signal-speed")[1]
    assert signal.count("preset ") == 7
    assert signal.count("with --engine sumo-jax") == 1
    one = mbtl_command.document("cmdps", "ring-acc")
    assert one["presets_elsewhere"]["sumo"]["quick"]["budget"] == sumo["quick"].budget


def test_check_fails_a_dead_axis_after_showing_the_report(mbtl_command):
    code, out, _ = mbtl_command("check", f"{__file__}:dead")
    assert (code, "11 of 12 checks hold, 1 failed" in out) == (1, True)
    code, out, _ = mbtl_command("check", f"{__file__}:dead", "--json")
    assert (code, json.loads(out)["ok"]) == (1, False)


def test_check_on_a_user_s_problem(mbtl_command):
    mbtl_command.done("check", f"{__file__}:cmdp")


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("cartpole-lenght", "Did you mean 'cartpole-length'"),
        (f"{__file__}:number", "must be a CMDP"),
        (f"{__file__}:make_env", "must be a CMDP, got a function; build one"),
    ],
)
def test_wrong_usage_is_named(mbtl_command, argument, words):
    assert words in mbtl_command.refusal("check", argument)
