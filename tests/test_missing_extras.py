"""A missing optional package costs one line that says how to install it."""

import subprocess
import sys

import pytest

BLOCKED = """
import sys
from importlib.machinery import PathFinder
find = PathFinder.find_spec
def find_spec(name, path=None, target=None):
    return None if name.split('.')[0] in {blocked!r} else find(name, path, target)
PathFinder.find_spec = find_spec
"""
MAIN = "sys.argv = ['mbtl', *{arguments!r}]\nfrom mbtl.cli import main\nmain()"


def run_without(blocked, arguments, cwd):
    program = BLOCKED.format(blocked=blocked) + MAIN.format(arguments=arguments)
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=cwd)


@pytest.mark.parametrize(
    ("blocked", "arguments", "install"),
    [
        (
            ["stable_baselines3", "sb3_contrib", "torch"],
            ["matrix", "build", "cartpole-length", "--engine", "gymnasium", "--workers", "1"],
            "mbtl[train]",
        ),
        (
            ["jax"],
            ["matrix", "build", "cartpole-length", "--engine", "jax", "--workers", "1"],
            "mbtl[jax]",
        ),
        (["gymnasium"], ["check", "cartpole-length"], "mbtl["),
        (["Box2D"], ["check", "walker-gravity"], "mbtl[envs]"),
    ],
)
def test_the_command_says_what_to_install(tmp_path, blocked, arguments, install):
    done = run_without(blocked, arguments, tmp_path)
    assert done.returncode == 1, done.stderr
    assert install in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ["cmdps"],
        ["bench", "--matrix", "synthetic:linear-gap", "--budget", "3", "--selectors", "greedy"],
    ],
)
def test_what_needs_no_extra_works_without(tmp_path, arguments):
    blocked = [
        "stable_baselines3",
        "sb3_contrib",
        "torch",
        "gymnasium",
        "matplotlib",
        "tensorboard",
        "jax",
    ]
    done = run_without(blocked, arguments, tmp_path)
    assert done.returncode == 0, done.stderr


def test_a_run_without_matplotlib_keeps_its_result(tmp_path):
    (tmp_path / "own.py").write_text(
        "import mbtl\n"
        "space = mbtl.ContextSpace.grid({mbtl.Linear('x', 0, 1): 5})\n"
        "problem = mbtl.CMDP.from_functions('own', space, train=lambda c, s: c['x'], budget=2,\n"
        "    evaluate=lambda p, cs, s: [1 - abs(c['x'] - p) for c in cs])\n"
    )
    done = run_without(["matplotlib"], ["run", "own.py:problem"], tmp_path)
    assert done.returncode == 0, done.stderr
    assert "no pictures: matplotlib is needed" in " ".join(done.stdout.split())
