"""SUMO in processes as a world: what the engine plays there is what the environments play."""

import os

import numpy as np
import pytest

from mbtl.engine import SceneProblem
from mbtl.engine.worlds import processes
from mbtl.errors import InvalidInput, TrainingFailed
from mbtl.problems import get_cmdp
from mbtl.trainers import reference_rows
from mbtl.zoo.cmdps.registry import engines_of

HOLD = {"hold": 40.0}
SHORT = {
    "episodes": 2, "checkpoint_every": 2, "checkpoint_episodes": 1,
    "hyperparameters": {"n_episodes": 2},
}  # fmt: skip


def trainer(id, engine, **options):
    return get_cmdp(id, engine=engine).trainer_for("quick", eval_episodes=1, **options)


@pytest.mark.parametrize("id", ["ring-acc", pytest.param("ramp-vel", marks=pytest.mark.long)])
def test_a_policy_and_traffic_without_one_score_as_in_the_environments(id):
    """On the ramp, where agents come and go, with one that has learnt."""
    contexts, school = [HOLD], trainer(id, "sumo-jax", **SHORT)
    policy = untrained = school.untrained(HOLD)
    if id == "ramp-vel":
        policy = school.train(contexts, seed=0).policy
        assert any((a != b).any() for a, b in zip(policy.weights, untrained.weights, strict=True))
    here, there = (trainer(id, engine, acting="mean") for engine in ("sumo-jax", "sumo"))
    np.testing.assert_allclose(
        here.evaluate(policy, contexts, [5]), there.evaluate(policy, contexts, [5]), rtol=1e-5
    )
    free = [reference_rows(one, contexts, [5])["unguided"] for one in (here, there)]
    np.testing.assert_allclose(*free, rtol=1e-5)


DIE_IN_MID_EPISODE = """
import os, signal
from mbtl.engine import scene
scene._served.step = lambda action: os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_simulator_that_dies_fails_its_training_and_the_next_one_runs():
    school = trainer("ring-acc", "sumo-jax", **{**SHORT, "episodes": 4})
    killed = []

    def kill(progress):  # between two episodes, where a process that has died is only replaced
        if killed:
            return
        world, _ = school.problem([HOLD])
        killed.extend(processes._crew(world.scene, os.getpid()))
        killed[0].submit(exec, DIE_IN_MID_EPISODE, {}).result()

    with (
        pytest.warns(RuntimeWarning, match="a simulation failed"),
        pytest.raises(TrainingFailed, match="finite"),
    ):
        school.train([HOLD], 0, on_progress=kill)
    assert np.isfinite(school.evaluate(school.untrained(HOLD), [HOLD], [0])).all()


def test_all_traffic_can_be_learnt_in_processes():
    for id in ("signal-inflow", "eco-green", "ring-vel", "ramp-acc"):
        assert "sumo-jax" in engines_of(id)
        world, params = get_cmdp(id, engine="sumo-jax").trainer.problem([get_cmdp(id).nominal] * 2)
        assert world.decisions(params) > 1
        assert params.visible.shape == (2, 0)


def test_more_episodes_than_processes_are_refused():
    many = {"hyperparameters": {"n_episodes": processes.MOST + 1}}
    school = trainer("ring-vel", "sumo-jax", **{**SHORT, **many})
    with pytest.raises(InvalidInput, match=f"at most {processes.MOST} times at once"):
        school.train([HOLD], 0)


def test_environments_that_cannot_be_sent_are_refused():
    make_env = get_cmdp("ring-vel").make_env
    problem = SceneProblem(lambda context: make_env(context))
    with pytest.raises(InvalidInput, match="a function of a module"):
        problem([HOLD])
