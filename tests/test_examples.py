"""The examples run as they stand, and do what their text says."""

import pickle
import runpy
import sys
from pathlib import Path

import pytest
from played import played

EXAMPLES = Path(__file__).parents[1] / "examples"
NEEDS = {"own_sumo_network": ("sumo", "libsumo", "stable_baselines3")}
LONG = {"own_sumo_network"}  # three trainings in SUMO


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.long] * (path.stem in LONG))
        for path in sorted(EXAMPLES.glob("*.py"))
    ],
)
def test_an_example_runs(path, tmp_path, monkeypatch, capsys):
    for package in NEEDS.get(path.stem, ()):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(path)])
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out


def test_the_traffic_lights_are_those_of_a_scenario_of_the_user(monkeypatch):
    pytest.importorskip("libsumo")
    config = Path(pytest.importorskip("sumo").SUMO_HOME, "tools", "game", "corridor.sumocfg")
    monkeypatch.setenv("CONFIG", str(config))
    example = runpy.run_path(str(EXAMPLES / "own_sumo_network.py"))
    delays = []
    for demand in (0.5, 2.0):
        env = example["problem"].make_env({"demand": demand})
        assert len(env.control.lights) == 3
        env.reset(seed=0)
        outcomes = played(lambda env=env: env.follow("actuated"))
        delays.append(outcomes[-1][4]["delay"])
        env.close()
    assert delays[1] > 1.5 * delays[0]  # the context reaches the scenario


def test_an_example_can_be_sent_to_other_processes():
    """`mbtl run examples/own_simulator.py:problem --parallel 2`."""
    from mbtl.problems import resolve_cmdp

    problem = resolve_cmdp(f"{EXAMPLES / 'own_simulator.py'}:problem")
    assert pickle.loads(pickle.dumps(problem.trainer)) == problem.trainer


def test_examples_are_short():
    """Without blank lines."""
    for path in EXAMPLES.glob("*.py"):
        assert sum(bool(line.strip()) for line in path.read_text().splitlines()) < 60, path.name
    readme = (EXAMPLES.parent / "README.md").read_text()
    code = readme.split("```python\n# my_problem.py")[1].split("```")[0]
    assert len([line for line in code.splitlines() if line.strip()]) <= 18
