"""Settings of the whole test run, made before numpy and jax are imported."""

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
def mbtl_command(capsys, monkeypatch, tmp_path):
    """Run the program in a folder of its own: arguments -> (exit code, stdout, stderr)."""
    from mbtl.cli import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(sys, "path", list(sys.path))

    def invoke(*arguments):
        monkeypatch.setattr(sys, "argv", ["mbtl", *map(str, arguments)])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    before = set(sys.modules)
    yield invoke
    for name in set(sys.modules) - before:  # a user's modules in tmp_path, of this test only
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


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
