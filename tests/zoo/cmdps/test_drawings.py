"""Pictures of CartPole, Pendulum and HalfCheetah show the state and the context."""

from dataclasses import replace

import numpy as np
import pytest

from mbtl.problems import get_cmdp
from mbtl.zoo.cmdps.drawing import draw_cart


def drawn(id, context=None):
    cmdp = get_cmdp(id, engine="gymnasium")
    options = {**cmdp.make_env.options, "render_mode": "rgb_array"}
    env = replace(cmdp.make_env, options=options)(context or cmdp.nominal)
    env.reset(seed=0)
    return env


def brown(picture):
    """Where the pole is."""
    return (picture == (200, 130, 60)).all(axis=2)


@pytest.mark.parametrize("id", ["cartpole-length", "pendulum-mass", "cheetah-gravity"])
def test_a_picture_follows_the_state_and_none_is_drawn_unasked(id):
    if id.startswith("cheetah"):
        pytest.importorskip("mujoco", reason="the envs extra is not installed")
    env = drawn(id)
    first = env.render()
    assert first.dtype == np.uint8
    assert first.shape[2] == 3
    for _ in range(5):
        env.step(env.action_space.high if hasattr(env.action_space, "high") else 1)
    assert (env.render() != first).any()
    cmdp = get_cmdp(id, engine="gymnasium")
    assert cmdp.make_env(cmdp.nominal).render() is None


def test_a_cart_leans_where_it_leans_and_a_heavy_one_is_larger():
    look = {"length": 0.5, "cart": 1.0, "pole": 0.1, "reach": 2.4}
    columns = brown(draw_cart(0.0, 0.2, **look)).any(axis=0).nonzero()[0]
    assert columns.mean() > 180
    blue = [
        (draw_cart(0.0, 0.0, **{**look, "cart": cart}) == (0, 114, 178)).all(axis=2).sum()
        for cart in (0.1, 1.0, 10.0)
    ]
    assert blue[0] < blue[1] < blue[2]
