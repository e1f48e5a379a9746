"""HalfCheetah: Gymnasium's where the context is nominal, and other physics where it is not."""

import copy

import numpy as np
import pytest
from played import begun

pytest.importorskip("mujoco", reason="the envs extra is not installed")

import gymnasium
import mujoco

from mbtl.errors import ContextMismatch
from mbtl.problems import get_cmdp
from mbtl.zoo.cmdps.locomotion.cheetah import MOTORS, HalfCheetah, base_model

STILL = np.zeros(6)
ENDS = {"gravity": (0.981, 98.1), "friction": (0.04, 4.0), "stiffness": (0.1, 10.0)}
CORNERS = [{axis: value} for axis, ends in ENDS.items() for value in ends]


@pytest.fixture(scope="module")
def theirs(tmp_path_factory):
    pytest.importorskip("imageio", reason="Gymnasium's MuJoCo environments need it")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("mujoco"))  # it logs that its file is of an old kind
        yield gymnasium.make("HalfCheetah-v5").unwrapped


def test_the_model_is_gymnasium_s(theirs):
    ours, other = base_model(), theirs.model
    looks = ("cam_", "light_", "mat_", "tex_", "geom_rgba", "geom_matid", "geom_user", "name")
    for name in filter(lambda name: not name.startswith(("_", *looks)), dir(other)):
        value = getattr(other, name)
        if isinstance(value, np.ndarray) and name != "geom_size":
            np.testing.assert_array_equal(getattr(ours, name), value, err_msg=name)
    np.testing.assert_array_equal(ours.geom_size[1:], other.geom_size[1:])  # but the floor's


def test_agrees_step_for_step_with_gymnasium_at_the_nominal_context(theirs):
    ours = HalfCheetah({"gravity": 9.81}, visibility="hidden")
    assert ours.action_space == theirs.action_space
    assert ours.observation_space.shape == theirs.observation_space.shape
    ours.reset(seed=0)
    theirs.reset(seed=0)
    theirs.set_state(*ours.state)
    rng = np.random.default_rng(0)
    for _ in range(1000):
        action = rng.uniform(-1.2, 1.2, 6).astype(np.float32)
        got, want = ours.step(action), theirs.step(action)
        np.testing.assert_array_equal(ours.state[0], theirs.data.qpos)
        np.testing.assert_array_equal(ours.state[1], theirs.data.qvel)
        np.testing.assert_array_equal(got[0], want[0].astype(np.float32))
        assert got[1] == pytest.approx(want[1], abs=1e-6)
    assert got[2:4] == (False, True)


@pytest.mark.parametrize("context", CORNERS[::2], ids=str)
def test_without_torque_it_comes_to_rest(context):
    env = begun(HalfCheetah(context))
    rewards = [env.drive()[1] for _ in range(1000)]
    assert np.isfinite(env.state).all()
    assert np.abs(rewards[-100:]).max() < 0.05
    assert abs(sum(rewards)) < 50.0  # of 6000


def test_mujoco_derives_nothing_from_a_context():
    model = HalfCheetah({"gravity": 50.0, "friction": 3.0, "stiffness": 7.0}).model
    again = copy.copy(model)
    mujoco.mj_setConst(again, mujoco.MjData(again))
    for name in dir(model):
        if isinstance(getattr(model, name), np.ndarray):
            np.testing.assert_array_equal(getattr(again, name), getattr(model, name), err_msg=name)
    assert model.opt.gravity.tolist() == [0.0, 0.0, -50.0]
    assert set(model.geom_friction[:, 0]) == {3.0}
    np.testing.assert_array_equal(
        model.jnt_stiffness, [0, 0, 0, *(7.0 * base_model().jnt_stiffness[MOTORS])]
    )


def test_what_is_not_a_number_is_not_hidden():
    env = begun(HalfCheetah())
    assert np.isnan(env.step(np.full(6, np.nan))[1])
    env.data.qpos[3] = np.nan
    for _ in range(2):
        observation, reward, *_ = env.step(STILL)
        assert np.isnan(observation[:8]).all()
        assert np.isnan(reward)


@pytest.mark.parametrize(
    "context", [{"friction": -0.4}, {"stiffness": 0.0}, {"gravity": float("nan")}, {"gravity": "9"}]
)
def test_contexts_that_no_model_can_have_are_refused(context):
    with pytest.raises(ContextMismatch, match="finite numbers > 0"):
        HalfCheetah(context)
    cmdp = get_cmdp(f"cheetah-{next(iter(context))}", engine="gymnasium")
    with pytest.raises(ContextMismatch):
        cmdp.make_env(context)
