"""What the laboratory says it provides is there, and is not imported before it is asked for."""

import pkgutil
import subprocess
import sys

import pytest
import typer

import mbtl
from mbtl.provider import laboratory
from mbtl.zoo.cmdps import registry


@pytest.mark.parametrize("name", laboratory().names)
def test_names_of_the_laboratory_are_those_of_mbtl(name):
    assert name in mbtl.__all__
    assert getattr(mbtl, name) is pkgutil.resolve_name(laboratory().names[name])


@pytest.mark.parametrize("name", laboratory().commands)
def test_commands_of_the_laboratory_are_there(name):
    found = pkgutil.resolve_name(laboratory().commands[name])
    assert isinstance(found, typer.Typer) or callable(found)


def test_a_cmdp_is_made_with_its_switches():
    assert list(laboratory().ids()) == registry.cmdp_ids()
    hidden = mbtl.get_cmdp("cartpole-length", visibility="hidden")
    assert hidden.settings["visibility"] == "hidden"


def test_what_is_no_matrix_is_left_to_others(tmp_path):
    assert laboratory().subject(str(tmp_path), selector="specialists", budget=2, seed=0) is None


def test_commands_of_the_tool_import_none_of_the_laboratory():
    program = (
        "import sys; from mbtl.cli import main; sys.argv = ['mbtl', 'run', '--help']\n"
        "try: main()\nexcept SystemExit: pass\n"
        "print([m for m in sys.modules if m.startswith(('mbtl.zoo', 'mbtl.engine'))])"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout
    assert said.splitlines()[-1] == "[]"
