"""Settings of the whole test run, made before numpy and jax are imported."""

import json
import os
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# the matrices are tiny: more threads only get in each other's way, badly so on a busy machine
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# compiling takes most of the time of jax's tests: what one process compiled, the others read (the
# key has versions, flags and the kind of processor, and XLA checks the processor again)
compiled = Path(__file__).parents[1] / "build" / "compiled"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(compiled))
os.environ.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(200 << 20))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")

# a slow machine is no failure
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """An empty folder to work in; modules that are imported from there are forgotten."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


class Program:
    """Runs `mbtl`: arguments -> (exit code, stdout, stderr)."""

    def __init__(self, capsys, monkeypatch):
        self.capsys, self.monkeypatch = capsys, monkeypatch

    def __call__(self, *arguments):
        from mbtl.cli import main

        self.monkeypatch.setattr(sys, "argv", ["mbtl", *map(str, arguments)])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        captured = self.capsys.readouterr()
        return code, captured.out, captured.err

    def done(self, *arguments):
        """What it prints where it succeeds."""
        code, out, err = self(*arguments)
        assert code == 0, err
        return out

    def document(self, *arguments):
        """The same as data."""
        return json.loads(self.done(*arguments, "--json"))

    def refusal(self, *arguments, code=2):
        """What it says, without line breaks, where it gives nothing but a complaint."""
        found, out, err = self(*arguments)
        assert (found, out, "Traceback" in err) == (code, "", False), err
        return " ".join(err.split())


@pytest.fixture
def mbtl_command(folder, capsys, monkeypatch):
    """The program in a folder of its own."""
    monkeypatch.setenv("COLUMNS", "100")
    return Program(capsys, monkeypatch)


@pytest.fixture
def undrawn(monkeypatch):
    """`mbtl run` draws nothing, which takes two thirds of a short one."""
    for picture in ("curve", "policy_map"):
        monkeypatch.setattr(f"mbtl.cli.run.{picture}", lambda study, **how: None)
    monkeypatch.setattr("mbtl.cli.run.save", lambda picture, path: path)


@pytest.fixture
def opened():
    """Simulations and environments that are closed at the end of the test."""
    made = []

    def opened(one):
        made.append(one)
        return one

    yield opened
    for one in made:
        one.close()
