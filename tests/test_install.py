"""tools/install: uv where it can be had, pip otherwise, and never the CUDA build unannounced."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PYTHON = """#!/bin/sh
case "$*" in
    "-m pip config list") printf '%s' "$PIP_CONFIG" ;;
    "-c "*) exit "$TORCH_MISSING" ;;
    *) echo "pip $*" >> "$CALLS"; case "$*" in *"$PIP_FAILS"*) exit 1 ;; esac ;;
esac
"""
UV = """#!/bin/sh
echo "uv $*" >> "$CALLS"
case "$*" in *"$UV_FAILS"*) echo "error: no such file" >&2; exit 2 ;; esac
printf 'Downloading scipy (33.7MiB)\\n + scipy==1.17.1\\n' >&2
"""


@pytest.fixture
def install(tmp_path):
    def write(path, text):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        path.chmod(0o755)

    write(tmp_path / ".venv/bin/python", PYTHON)
    write(tmp_path / "bin/uv", UV)
    (tmp_path / "tools").mkdir()
    shutil.copy(ROOT / "tools/install", tmp_path / "tools")
    (tmp_path / "constraints.txt").write_text("scipy==1.17.1\ntorch==2.13.0\n")

    def call(*arguments, **settings):
        calls = tmp_path / "calls"
        calls.write_text("")
        environment = {
            "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}",
            "CALLS": str(calls),
            "PIP_CONFIG": "global.extra-index-url='file:///wheels'\n",
            "PIP_FAILS": "nothing",
            "UV_FAILS": "nothing",
            "TORCH_MISSING": "1",
        }
        done = subprocess.run(
            [tmp_path / "tools/install", *arguments],
            env=environment | settings,
            capture_output=True,
            text=True,
            check=True,
        )
        return [line.split() for line in calls.read_text().splitlines()], done.stderr

    return call


EDITABLE = ("--editable", ".[jax,plots]")
NO_CPU = {"PIP_FAILS": "+cpu"}


@pytest.mark.parametrize(
    ("arguments", "settings", "tools", "last", "said"),
    [
        (EDITABLE, {}, ["uv"], EDITABLE, "Downloading scipy (33.7MiB)\n"),
        (EDITABLE, {"UV_FAILS": "--editable"}, ["uv", "pip"], EDITABLE, "now with pip"),
        (EDITABLE, {"PIP_CONFIG": "global.index-url='mirror'\n"}, ["pip"], EDITABLE, ""),
        # torch: where pip looks if that is a CPU build, else its own index, else announced
        (("torch",), {}, ["pip"], ("torch==2.13.0+cpu",), ""),
        (("torch",), NO_CPU, ["pip", "uv"], ("--torch-backend", "cpu", "torch==2.13.0"), ""),
        (("torch",), NO_CPU | {"UV_FAILS": "--torch-backend"}, None, ("torch",), "CUDA build"),
        (("torch",), {"TORCH_MISSING": "0"}, [], (), ""),
    ],
)
def test_uv_installs_where_it_can_and_pip_elsewhere(
    install, arguments, settings, tools, last, said
):
    calls, heard = install(*arguments, **settings)
    assert tools is None or [tool for tool, *_ in calls] == tools
    assert not last or tuple(calls[-1][-len(last) :]) == last
    assert said in heard
    assert ("CUDA" in heard) == ("CUDA" in said)
