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


TRAIN = ["stable_baselines3", "sb3_contrib", "torch"]
BUILD = ["matrix", "build", "cartpole-length", "--workers", "1", "--engine"]
SYNTHETIC = ["--matrix", "synthetic:linear-gap", "--budget", "3", "--selectors", "greedy"]


def test_the_command_says_what_to_install_and_what_needs_no_extra_works_without(tmp_path):
    """What is blocked later was not imported before; a run without matplotlib keeps its result."""
    (tmp_path / "own.py").write_text(
        "import mbtl\n"
        "space = mbtl.ContextSpace.grid({mbtl.Linear('x', 0, 1): 5})\n"
        "problem = mbtl.CMDP.from_functions('own', space, train=lambda c, s: c['x'], budget=2,\n"
        "    evaluate=lambda p, cs, s: [1 - abs(c['x'] - p) for c in cs])\n"
    )
    every = [*TRAIN, "gymnasium", "matplotlib", "jax"]
    cases = (
        (every, ["run", "own.py:problem"], "0", ""),
        (every, ["cmdps"], "0", ""),
        (every, ["bench", *SYNTHETIC], "0", ""),
        (["gymnasium"], ["check", "cartpole-length"], "1", "mbtl["),
        (["Box2D"], ["check", "walker-gravity"], "1", "mbtl[envs]"),
        (["jax"], [*BUILD, "jax"], "1", "mbtl[jax]"),
        (TRAIN, [*BUILD, "gymnasium"], "1", "mbtl[train]"),
    )
    program = [sys.executable, "-c", PROGRAM.format(cases=[case[:2] for case in cases])]
    done = subprocess.run(program, capture_output=True, text=True, cwd=tmp_path, check=True)
    assert "Traceback" not in done.stderr
    assert "no pictures: matplotlib is needed" in " ".join(done.stdout.split())
    said = re.split(r"=== (\w+)\n", done.stderr)
    for i, (_, arguments, code, install) in enumerate(cases):
        words = " ".join(said[2 * i].split())
        assert (said[2 * i + 1], install in words) == (code, True), arguments
