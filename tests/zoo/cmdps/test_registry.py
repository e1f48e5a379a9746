import pickle
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from mbtl.errors import ContextMismatch, InvalidInput, UnknownName
from mbtl.problems import cmdp_ids, get_cmdp
from mbtl.zoo.cmdps import gym_id
from mbtl.zoo.cmdps.families import TRAFFIC_VARIANTS

GRIDS = {
    # id: axis, its unit, N, first value, unit of the multiplier, nominal, bounds, theta, horizon
    "cartpole-masscart": ("masscart", "kg", 100, 0.1, 1.0, 1.0, (0.0, 500.0), 0.005, 500),
    "cartpole-length": ("length", "m", 100, 0.05, 0.5, 0.5, (0.0, 500.0), 0.005, 500),
    "cartpole-masspole": ("masspole", "kg", 100, 0.01, 0.1, 0.1, (0.0, 500.0), 0.005, 500),
    "pendulum-length": ("length", "m", 100, 0.1, 1.0, 1.0, (-2200.0, -500.0), 0.005, 200),
    "pendulum-mass": ("mass", "kg", 100, 0.1, 1.0, 1.0, (-2200.0, -500.0), 0.005, 200),
    "pendulum-timestep": ("timestep", "s", 100, 0.005, 0.05, 0.05, (-2200.0, -500.0), 0.005, 200),
    "walker-gravity": ("gravity", "m/s^2", 100, 0.2, 2.0, 10.0, (-150.0, 300.0), 0.005, 1000),
    "walker-friction": ("friction", "1", 100, 0.1, 1.0, 2.5, (-150.0, 300.0), 0.005, 1000),
    "walker-scale": ("scale", "px/m", 100, 1.0, 10.0, 30.0, (-150.0, 300.0), 0.005, 1000),
    "signal-length": ("length", "m", 50, 50.0, 500.0, 750.0, (-120.0, 0.0), 0.001, 540),
    "signal-inflow": ("inflow", "cars", 50, 50.0, 500.0, 1000.0, (-120.0, 0.0), 0.001, 540),
    "signal-speed": ("speed", "m/s", 50, 0.5, 5.0, 14.0, (-120.0, 0.0), 0.001, 540),
    "eco-penetration": ("penetration", "share", 50, 0.02, 0.2, 0.2, (0.0, 14.0), 0.005, 1500),
    "eco-inflow": ("inflow", "veh/h", 50, 40.0, 400.0, 400.0, (0.0, 14.0), 0.005, 1500),
    "eco-green": ("green", "s", 50, 1.0, 10.0, 35.0, (0.0, 14.0), 0.005, 1500),
    "ring-acc": ("hold", "s", 40, 1.0, 10.0, 1.0, (0.0, 4.5), 0.005, 400),
    "ring-vel": ("hold", "s", 40, 1.0, 10.0, 1.0, (0.0, 4.5), 0.005, 400),
    "ramp-acc": ("hold", "s", 40, 1.0, 10.0, 1.0, (0.0, 8.78), 0.005, 400),
    "ramp-vel": ("hold", "s", 40, 1.0, 10.0, 1.0, (0.0, 8.78), 0.005, 400),
}


@pytest.mark.parametrize("id", GRIDS)
def test_grids_and_constants_of_the_paper(id):
    axis, physical, n, first, unit, nominal, bounds, theta, horizon = GRIDS[id]
    cmdp = get_cmdp(id)
    values = cmdp.space.values(axis)
    np.testing.assert_allclose(values, first * np.arange(1, n + 1), rtol=1e-12)
    assert all(len(repr(value)) <= 6 for value in values), "contexts print as they are meant"
    assert cmdp.space.axes[0].unit == physical
    assert (cmdp.unit, cmdp.nominal) == ({axis: unit}, {axis: nominal})
    assert (cmdp.bounds, cmdp.theta, cmdp.horizon) == (bounds, theta, horizon)
    if id in TRAFFIC_VARIANTS:
        shown = id in ("eco-penetration", "eco-green")  # the reference hides the rest
        assert cmdp.settings["visibility"] == ("multiplier" if shown else "hidden")
        assert cmdp.version == {"signal": 4, "eco": 2}.get(cmdp.family, 1)
        assert cmdp.floor == (-120.0 if cmdp.family == "signal" else None)


@pytest.mark.parametrize(
    ("id", "multipliers", "digits"),
    [("walker-512", range(1, 9), 12), ("cartpole-masses-length", range(1, 11), 2)],
)
def test_grids_of_several_axes_are_multiples_of_the_nominal_values(id, multipliers, digits):
    cmdp = get_cmdp(id)
    assert cmdp.unit == cmdp.nominal
    for axis, nominal in cmdp.nominal.items():
        expected = [round(nominal * 0.2 * k, digits) for k in multipliers]
        if axis == "length":
            del expected[0]  # as in the scripts of SD-MBTL, which round so, too
        np.testing.assert_allclose(np.unique(cmdp.space.values(axis)), expected, rtol=1e-12)


def test_the_paper_s_scores_are_switches_with_their_own_bounds():
    eco, signal = (get_cmdp(id, score="paper") for id in ("eco-green", "signal-inflow"))
    assert (eco.bounds, eco.floor, eco.settings["score"]) == ((0.0, 15.0), None, "paper")
    assert (signal.bounds, signal.floor) == ((-100.0, 0.0), -100.0)
    for cmdp, default in ((eco, "everyone"), (signal, "delay")):
        assert get_cmdp(cmdp.id).settings == {**cmdp.settings, "score": default}
        assert cmdp.trainer.problem([])[0].scored == "paper"
        assert cmdp.make_env.options["score"] == "paper"
    with pytest.raises(UnknownName, match="one score; leave the choice out"):
        get_cmdp("ring-acc", score="paper")
    with pytest.raises(UnknownName, match="everyone, paper"):
        get_cmdp("eco-green", score="all")


ROBOTS = ["walker-gravity", "walker-friction", "walker-scale", "walker-512"]
ROBOTS += ["cheetah-gravity", "cheetah-friction", "cheetah-stiffness"]


def test_all_ids():
    control = ["cartpole-masscart", "cartpole-length", "cartpole-masspole"]
    control += ["cartpole-masses-length"]
    control += ["pendulum-length", "pendulum-mass", "pendulum-timestep"]
    assert cmdp_ids() == [*control, *ROBOTS, *TRAFFIC_VARIANTS]


def test_where_the_paper_s_text_and_scripts_disagree():
    differ = [id for id in cmdp_ids() if get_cmdp(id, grid="paper").space != get_cmdp(id).space]
    robots = [*ROBOTS[:3], *ROBOTS[4:6]]
    assert differ == [*robots, "signal-length", "signal-speed", "eco-green"]
    assert get_cmdp("eco-green", grid="paper").space.values("green")[-1] == 175.0


def test_switches_reach_the_environment_and_the_record():
    switches = {"physics": "reference", "visibility": "raw", "time_limit": "terminal"}
    switches["engine"] = "gymnasium"
    cmdp = get_cmdp("cartpole-masscart", **switches)
    env = cmdp.make_env({"masscart": 7.0})
    np.testing.assert_allclose(env.reset(seed=0)[0][4:], [9.8, 7.0, 0.1, 0.5, 10.0, 0.02])
    assert cmdp.settings == {**switches, "grid": "code"}


@pytest.mark.parametrize(
    ("id", "context", "words"),
    [
        ("cartpole-length", {"length": 5.01}, r"\[0.05, 5\] m"),
        ("cartpole-length", {"length": float("nan")}, "nan"),
        ("cartpole-length", {"masscart": 1.0}, "Known: length"),
        ("ring-acc", {"hold": 41.0}, r"\[1, 40\] s"),
        ("ring-acc", {"hald": 4.0}, "Did you mean 'hold'"),
        ("eco-green", {"green": 20.0, "inflow": 800.0}, "Known: green"),
    ],
)
def test_what_is_no_context_of_a_cmdp_is_refused(id, context, words):
    cmdp = get_cmdp(id)
    for make in (
        partial(cmdp.make_env, context),
        partial(gymnasium.make, gym_id(id), context=context),
        partial(cmdp.trainer.problem, [cmdp.nominal, context]),
    ):
        with pytest.raises(ContextMismatch, match=words):
            make()


def test_between_the_values_of_the_grid_a_context_is_as_good_as_on_them():
    env = get_cmdp("cartpole-length").make_env({"length": 0.512})
    assert env.features["length"] == 0.512
    sent = pickle.loads(pickle.dumps(get_cmdp("cartpole-length").make_env))
    assert sent({"length": 1.2}).features["length"] == 1.2
    wide = get_cmdp("signal-speed", grid="paper").space.axes[0].high
    assert get_cmdp("signal-speed", grid="paper").make_env.check({"speed": wide}) is None
    with pytest.raises(ContextMismatch):
        get_cmdp("signal-speed").make_env.check({"speed": wide})


def test_presets_and_overrides_shape_the_trainer():
    cmdp = get_cmdp("pendulum-length", engine="gymnasium")
    assert list(cmdp.presets) == ["quick", "paper"]
    assert cmdp.default_preset == "quick"
    assert cmdp.trainer == cmdp.trainer_for() == cmdp.trainer_for("quick")
    paper = cmdp.trainer_for("paper")
    assert (paper.timesteps, paper.eval_episodes, paper.checkpoint) == (1_000_000, 100, "best")
    assert paper.hyperparameters == {}, "a recipe that names its algorithm starts afresh"
    other = get_cmdp("cartpole-length", engine="gymnasium")
    assert other.trainer_for("paper").timesteps == 5_000_000
    assert cmdp.preset("paper").budget == 15
    quick = cmdp.trainer_for("quick").hyperparameters  # others add to them
    more = cmdp.trainer_for("quick", hyperparameters={"n_epochs": 3})
    assert more.hyperparameters == {**quick, "n_epochs": 3}
    sac = cmdp.trainer_for("quick", algorithm="SAC", hyperparameters={"gamma": 0.9})
    assert (sac.algorithm, sac.hyperparameters) == ("SAC", {"gamma": 0.9})


def test_a_preset_called_paper_is_the_papers_recipe_in_every_engine():
    cmdp = get_cmdp("cartpole-length", engine="jax")
    assert cmdp.default_preset == "full"
    full, paper = cmdp.trainer_for("full"), cmdp.trainer_for("paper")
    assert (full.recipe_name, paper.recipe_name) == ("fast", "sb3")
    assert (full.hyperparameters, paper.hyperparameters) == ({"gamma": 0.99}, {})
    steps_and_episodes = [(t.timesteps, t.eval_episodes, t.checkpoint) for t in (full, paper)]
    assert set(steps_and_episodes) == {(5_000_000, 100, "best")}
    ring = get_cmdp("ring-acc", engine="jax").trainer_for("paper")
    assert (ring.recipe_name, ring.episodes, ring.hyperparameters) == ("paper", 1000, {})


def test_unknown_presets_options_and_switches_are_named():
    cmdp = get_cmdp("cartpole-length", engine="gymnasium")
    with pytest.raises(UnknownName, match="Did you mean 'quick'"):
        cmdp.trainer_for("quik")
    with pytest.raises(UnknownName, match="Did you mean 'timesteps'"):
        cmdp.trainer_for(timestep=5)
    with pytest.raises(InvalidInput, match="timesteps"):
        cmdp.trainer_for(timesteps=0)
    for switch in ("physics", "visibility", "grid", "time_limit"):
        with pytest.raises(UnknownName, match=switch.replace("_", " ")):
            get_cmdp("cartpole-length", **{switch: "ideal"})


# ---- Gymnasium -----------------------------------------------------------------------------------


def test_gymnasium_makes_them_with_a_context():
    env = gymnasium.make("mbtl/cartpole-length-v0", context={"length": 1.2})
    assert env.reset(seed=0)[0][-1] == pytest.approx(2.4)
    assert gymnasium.make("mbtl/cartpole-length-v0").unwrapped.features["length"] == 0.5
    hidden = gymnasium.make("mbtl.zoo.cmdps:mbtl/pendulum-mass-v0", visibility="hidden")
    assert hidden.observation_space.shape == (3,)


@pytest.mark.parametrize("id", [id for id in cmdp_ids() if id not in TRAFFIC_VARIANTS])
@pytest.mark.filterwarnings("ignore:.*space (minimum|maximum) value is -?infinity")
@pytest.mark.filterwarnings("ignore:.*symmetric and normalized space")  # torques of +-2 are right
def test_gymnasium_s_own_checker_agrees(id):
    # to draw takes OpenGL, which not every machine has
    check_env(gymnasium.make(gym_id(id)).unwrapped, skip_render_check=True)


def test_stable_baselines3_s_own_checker_agrees():
    from stable_baselines3.common.env_checker import check_env as check_sb3

    check_sb3(get_cmdp("cartpole-length").make_env({"length": 1.0}), warn=False)
    check_sb3(get_cmdp("pendulum-length").make_env({"length": 1.0}), warn=False)
