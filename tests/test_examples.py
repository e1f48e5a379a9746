"""The examples run as they stand, and do what their text says."""

import importlib.util
import pickle
import runpy
import sys
from pathlib import Path

import pytest

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


def test_the_traffic_light_runs_in_a_network_of_the_user(tmp_path, monkeypatch):
    pytest.importorskip("libsumo")
    from mbtl.zoo.cmdps.traffic import simulation

    spec = importlib.util.spec_from_file_location("own_light", EXAMPLES / "own_sumo_network.py")
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    places = {"m": (0, 0), "a": (200, 0), "b": (-200, 0), "c": (0, -150)}
    nodes = "".join(f'<node id="{k}" x="{x}" y="{y}"/>' for k, (x, y) in places.items())
    edges = "".join(
        f'<edge id="{k}m" from="{k}" to="m"/><edge id="m{k}" from="m" to="{k}"/>' for k in "abc"
    )
    fork = {"nodes": f"<nodes>{nodes}</nodes>", "edges": f"<edges>{edges}</edges>"}
    own = tmp_path / "mine.net.xml"
    own.write_bytes(simulation.network(fork, "--tls.set", "m").read_bytes())
    monkeypatch.setenv("NET", str(own))
    monkeypatch.setattr(sys, "argv", ["mbtl", "check", "own_sumo_network.py:problem"])
    queues = []
    for demand in (40.0, 1500.0):
        env = example.Light({"demand": demand})
        seen, _ = env.reset(seed=0)
        assert env.roads == ["am", "bm", "cm"]
        assert seen.shape == env.observation_space.shape == (4,)
        ended = False
        while not ended:
            _, _, _, ended, info = env.step(0)
        queues.append(-info["score"])
        env.close()
    assert queues[1] > 1.5 * queues[0]  # the context reaches the network's first road


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
