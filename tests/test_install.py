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


def test_uv_installs_and_says_what_it_downloads(install):
    [(tool, *arguments)], said = install("--editable", ".[jax,plots]")
    assert tool == "uv"
    assert arguments[-2:] == ["--editable", ".[jax,plots]"]
    assert said == "Downloading scipy (33.7MiB)\n"


def test_pip_does_what_uv_could_not(install):
    calls, said = install("--editable", ".", UV_FAILS="--editable")
    assert [tool for tool, *_ in calls] == ["uv", "pip"]
    assert "no such file" in said
    assert "now with pip" in said


def test_an_index_that_pip_was_told_of_is_used(install):
    calls, _ = install("--editable", ".", PIP_CONFIG="global.index-url='mirror'\n")
    assert [tool for tool, *_ in calls] == ["pip"]


def test_torch_comes_from_where_pip_looks_if_that_is_a_cpu_build(install):
    [(tool, *arguments)], _ = install("torch")
    assert (tool, arguments[-1]) == ("pip", "torch==2.13.0+cpu")


def test_torch_comes_from_its_own_index_by_uv(install):
    calls, said = install("torch", PIP_FAILS="+cpu")
    assert calls[-1][-3:] == ["--torch-backend", "cpu", "torch==2.13.0"]
    assert "CUDA" not in said


def test_the_cuda_build_is_announced(install):
    calls, said = install("torch", PIP_FAILS="+cpu", UV_FAILS="--torch-backend")
    assert calls[-1][-1] == "torch"
    assert "CUDA build" in said


def test_torch_that_is_there_is_kept(install):
    calls, _ = install("torch", TORCH_MISSING="0")
    assert calls == []
