"""Pictures of CartPole, Pendulum and HalfCheetah show the state and the context."""

from dataclasses import replace

import numpy as np
import pytest

from mbtl.problems import get_cmdp
from mbtl.zoo.cmdps.drawing import Canvas, Window, draw_cart, draw_pendulum


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


@pytest.mark.parametrize("length", [0.05, 5.0])
def test_track_and_pole_of_any_length_are_in_the_picture(length):
    picture = draw_cart(2.4, 0.0, length=length, cart=1.0, pole=0.1, reach=2.4)
    shown = brown(picture)
    assert shown.any()
    assert not shown[[0, -1]].any()
    assert not shown[:, [0, -1]].any()


def test_an_upright_pendulum_is_above_its_pivot():
    up, down = (brown(draw_pendulum(angle, mass=1.0)) for angle in (0.0, np.pi))
    assert up.nonzero()[0].mean() < 120 < down.nonzero()[0].mean()


def test_the_cheetah_stays_in_the_middle_as_it_runs():
    pytest.importorskip("mujoco", reason="the envs extra is not installed")
    env = drawn("cheetah-gravity")
    position, speed = env.state
    position[0] += 7.0
    there = env.render()
    env.state = (position, speed)
    torso = [(p == (205, 150, 80)).all(axis=2).nonzero()[1].mean() for p in (there, env.render())]
    assert torso[0] == pytest.approx(torso[1], abs=1.0)


def test_a_disc_has_its_area():
    canvas = Canvas(Window(-1.0, -1.0, 1.0, 1.0), (255, 255, 255), long_side=400)
    canvas.disc(np.zeros(2), 0.5, (0, 0, 0))
    dark = 1.0 - canvas.image().mean() / 255.0
    assert dark == pytest.approx(np.pi * 0.25 / 4.0, rel=0.02)
