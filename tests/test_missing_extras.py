"""A missing optional package costs one line that says how to install it."""

import re
import subprocess
import sys

PROGRAM = """
import sys
from importlib.machinery import PathFinder
find, blocked = PathFinder.find_spec, []
def find_spec(name, path=None, target=None):
    return None if name.split('.')[0] in blocked else find(name, path, target)
PathFinder.find_spec = find_spec
for blocked, arguments in {cases!r}:
    sys.argv = ['mbtl', *arguments]
    from mbtl.cli import main
    try:
        main()
    except SystemExit as end:
        print(f'=== {{end.code}}', file=sys.stderr, flush=True)
"""


def ended(cases, cwd):
    """(exit code, what was said) of each command, all in one process."""
    program = [sys.executable, "-c", PROGRAM.format(cases=cases)]
    done = subprocess.run(program, capture_output=True, text=True, cwd=cwd, check=True)
    assert "Traceback" not in done.stderr
    said = re.split(r"=== (\w+)\n", done.stderr)
    return list(zip(said[1::2], said[::2], strict=False)), done.stdout


TRAIN = ["stable_baselines3", "sb3_contrib", "torch"]
BUILD = ["matrix", "build", "cartpole-length", "--workers", "1", "--engine"]
SYNTHETIC = ["--matrix", "synthetic:linear-gap", "--budget", "3", "--selectors", "greedy"]


def test_the_command_says_what_to_install_and_what_needs_no_extra_works_without(tmp_path):
    """What is blocked later was not imported before."""
    every = [*TRAIN, "gymnasium", "matplotlib", "tensorboard", "jax"]
    cases = (
        (every, ["cmdps"], "0", ""),
        (every, ["bench", *SYNTHETIC], "0", ""),
        (["gymnasium"], ["check", "cartpole-length"], "1", "mbtl["),
        (["Box2D"], ["check", "walker-gravity"], "1", "mbtl[envs]"),
        (["jax"], [*BUILD, "jax"], "1", "mbtl[jax]"),
        (TRAIN, [*BUILD, "gymnasium"], "1", "mbtl[train]"),
    )
    found, _ = ended([case[:2] for case in cases], tmp_path)
    for (code, said), (_, arguments, expected, install) in zip(found, cases, strict=True):
        assert (code, install in " ".join(said.split())) == (expected, True), arguments


def test_a_run_without_matplotlib_keeps_its_result(tmp_path):
    (tmp_path / "own.py").write_text(
        "import mbtl\n"
        "space = mbtl.ContextSpace.grid({mbtl.Linear('x', 0, 1): 5})\n"
        "problem = mbtl.CMDP.from_functions('own', space, train=lambda c, s: c['x'], budget=2,\n"
        "    evaluate=lambda p, cs, s: [1 - abs(c['x'] - p) for c in cs])\n"
    )
    [(code, _)], out = ended([(["matplotlib"], ["run", "own.py:problem"])], tmp_path)
    assert code == "0"
    assert "no pictures: matplotlib is needed" in " ".join(out.split())
