"""The walker in jax: Box2D's step by step, and what its parts promise."""

import numpy as np
import pytest

pytest.importorskip("jax", reason="the jax extra is not installed")

import mbtl.engine.worlds as worlds

import jax  # isort: skip
import jax.numpy as jnp  # isort: skip

from mbtl.zoo.worlds.walker import BipedalWalker, WalkerParams, WalkerState
from mbtl.zoo.worlds.walker import walker as twin
from mbtl.zoo.worlds.walker.walker import Box, apart, moved, touch

ENV = BipedalWalker()
WORLD = worlds.Solo(ENV)
INITIAL, STEP, OBSERVE = jax.jit(ENV.initial), jax.jit(ENV.step), jax.jit(ENV.observe)


def params(gravity=10.0, friction=2.5, scale=30.0, n=None):
    values = (jnp.float32(gravity), jnp.float32(friction), jnp.float32(scale), jnp.zeros(0))
    if n is None:
        return WalkerParams(*values)
    return WalkerParams(*(jnp.broadcast_to(v, (n, *v.shape)) for v in values))


@pytest.fixture(scope="module")
def box2d():
    pytest.importorskip("Box2D", reason="the envs extra is not installed")
    from mbtl.zoo.cmdps.locomotion import walker as theirs

    return theirs


MOST = 1000
"""Steps that may be played."""


@jax.jit
def _played(noise, actions, count, own):
    def one(i, state):
        return WORLD.step(state, jnp.broadcast_to(actions[i], (len(noise), 1, 4)), own).state

    return jax.lax.fori_loop(0, count, one, WORLD.start(noise, own))


def played(noise, actions, own):
    """Four walkers after these actions, (t, 4), which are all one's; one program for all tests."""
    padded = jnp.zeros((MOST, 4)).at[: len(actions)].set(actions)
    return _played(jnp.asarray(noise, jnp.float32), padded, len(actions), own)


def lucks(box2d, n):
    return np.random.default_rng(0).random((n, box2d.ROUGH + box2d.PATCHES + 1))


# ---- the ground ------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [3.0, 30.0, 300.0])
def test_the_ground_is_box2d_s(box2d, scale):
    for luck in lucks(box2d, 3):
        ours = twin.heights(jnp.asarray(luck[:-1], jnp.float32), jnp.float32(scale))
        np.testing.assert_allclose(ours, box2d.heights(luck, scale), atol=1e-4)


def test_ranges_of_level_ground_are_those_of_geometry():
    level = jnp.full(twin.POINTS, twin.HEIGHT)
    found = twin.ranges(level, jnp.array([20.0, twin.HEIGHT + 2.0]))
    turns = 1.5 * np.arange(twin.RAYS) / twin.RAYS
    np.testing.assert_allclose(found, np.minimum(2.0 / np.cos(turns) / twin.REACH, 1.0), atol=1e-5)


# ---- the body --------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1.0, 30.0, 100.0])
def test_the_inverse_is_that_of_the_mass_matrix(scale):
    angles = jnp.array([0.1, 0.4, -0.5, -0.3, -1.0])
    now = twin.body(jnp.array([5.0, 7.0]), angles, jnp.float32(scale))
    each = np.stack([twin.speeds(now, jnp.eye(7)[i]) for i in range(7)])  # (7, 5, 3)
    inertia = np.stack([now.masses, now.masses, now.moments], axis=1)
    mass = np.einsum("iab,jab,ab->ij", each, each, inertia)
    np.testing.assert_allclose(mass @ np.asarray(now.inverse), np.eye(7), atol=2e-3)


def test_bodies_move_as_their_speeds_say():
    centre, angles = jnp.array([5.0, 7.0]), jnp.array([0.1, 0.4, -0.5, -0.3, -1.0])
    u, short = jnp.array([0.5, -1.0, 0.3, 1.0, -2.0, 0.7, 1.5]), 1e-2
    ends = [
        twin.body(centre + side * short * u[:2], angles + side * short * u[2:], jnp.float32(30.0))
        for side in (-0.5, 0.5)
    ]
    now = twin.body(centre, angles, jnp.float32(30.0))
    moved = (ends[1].centres - ends[0].centres).T / short
    np.testing.assert_allclose(twin.speeds(now, u)[:, :2], moved, atol=2e-3)


def test_sine_and_cosine_are_numpy_s():
    angles = np.linspace(-300.0, 300.0, 100_001, dtype=np.float32)
    found = jax.jit(twin.sin_cos)(angles)
    exact = np.float64(angles)
    np.testing.assert_allclose(found, [np.sin(exact), np.cos(exact)], atol=2e-7)


def test_momentum_of_bodies_that_the_joints_hold_gives_their_motion_back():
    now = twin.body(jnp.zeros(2), jnp.array([0.1, 0.4, -0.5, -0.3, -1.0]), jnp.float32(30.0))
    u = jnp.array([0.5, -1.0, 0.3, 1.0, -2.0, 0.7, 1.5])
    again = now.inverse @ twin.momentum(now, twin.speeds(now, u))
    np.testing.assert_allclose(again, u, atol=1e-4)


def test_masses_are_box2d_s(box2d):
    walker = box2d.Walker(box2d.Constants(10.0, 2.5, 20.0), lucks(box2d, 1)[0])
    now = twin.body(jnp.zeros(2), jnp.zeros(5), jnp.float32(20.0))
    np.testing.assert_allclose(now.masses, [b.mass for b in walker.bodies], rtol=1e-5)
    centre = walker.bodies[0].localCenter
    np.testing.assert_allclose(twin.offset(jnp.float32(20.0)), tuple(centre), atol=1e-5)


# ---- contacts --------------------------------------------------------------------------------

PIECE = jnp.array([0.0, 0.0]), jnp.array([2.0, 0.0])


def test_a_box_that_lies_in_the_ground_touches_with_both_ends():
    lying = Box(jnp.array([1.0, 0.09]), jnp.float32(np.pi / 2), jnp.float32(0.2))
    found = touch(lying, PIECE)
    assert found.valid.all()
    np.testing.assert_allclose(found.gaps, [-0.03, -0.03], atol=1e-5)
    np.testing.assert_allclose(
        sorted(found.points[0]), 1.0 + np.array([-1, 1]) * 17 / 30, atol=1e-4
    )
    np.testing.assert_allclose(found.normals, [[0.0, 0.0], [1.0, 1.0]], atol=1e-6)


def test_a_box_beside_or_above_a_piece_does_not_touch_it():
    lying = jnp.float32(np.pi / 2)
    for x, y, far in ((1.0, 0.5, 0.4), (3.0, 0.0, 1.0 - 17 / 30)):
        box = Box(jnp.array([x, y]), lying, jnp.float32(0.2))
        assert not touch(box, PIECE).valid.any()
        assert float(apart(box, PIECE)) == pytest.approx(far, abs=1e-5)


# ---- the step --------------------------------------------------------------------------------


def test_a_step_is_box2d_s(box2d):
    """From Box2D's own states, under a gait with noise: without contact, and with."""
    heuristics = pytest.importorskip("gymnasium.envs.box2d.bipedal_walker").BipedalWalkerHeuristics
    step = jax.jit(
        lambda state, action: moved(
            state, jnp.sign(action) * twin.SPEEDS, twin.TORQUE * jnp.abs(action), params()
        )
    )
    rng, off, on = np.random.default_rng(0), [], []
    for luck in lucks(box2d, 3):
        walker, gait = box2d.Walker(box2d.Constants(10.0, 2.5, 30.0), luck), heuristics()
        gait.a = np.zeros(4)
        heights = jnp.asarray(box2d.heights(luck, 30.0), jnp.float32)
        seen, _, _ = box2d.advance([walker], np.zeros((1, 4), np.float32))
        first, touching = jnp.zeros(4, jnp.int32), jnp.zeros((4, 4), bool)
        for number in range(120):
            action = gait.step_heuristic(seen[0]) + rng.normal(0.0, 0.3, 4)
            action = np.clip(action, -1.0, 1.0).astype(np.float32)
            state = WalkerState(*_pose(walker), heights, first, touching, jnp.zeros(2, bool))
            new = step(state, jnp.asarray(action))
            first, touching = new.first, new.touching
            seen, _, over = box2d.advance([walker], action[None])
            if over[0]:
                break
            if number > 2:  # before, Box2D's legs are not where its joints hold them
                _, angles, moving = _pose(walker)
                error = (np.abs(new.angles - angles).max(), np.abs(new.moving - moving).max())
                (on if touching.any() else off).append(error)
    assert (len(off), len(on)) > (30, 60)
    off, on = np.array(off), np.array(on)
    np.testing.assert_array_less(np.quantile(off, 0.8, axis=0), [0.01, 0.01])
    np.testing.assert_array_less(np.median(on, axis=0), [0.005, 0.01])
    np.testing.assert_array_less(np.quantile(on, 0.8, axis=0), [0.03, 0.5])


def _pose(walker):
    bodies = walker.bodies
    centre = jnp.array(tuple(bodies[0].worldCenter), jnp.float32)
    angles = jnp.array([body.angle for body in bodies], jnp.float32)
    moving = [(*tuple(body.linearVelocity), body.angularVelocity) for body in bodies]
    return centre, angles, jnp.array(moving, jnp.float32)


# ---- the environment -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("action", "own"),
    [
        ((0, 0, 0, 0), {}),
        ((1, 1, 1, 1), {}),
        ((-1, 0.5, 1, -1), {}),
        ((1, -1, -1, 1), {"gravity": 2.0}),
        ((1, 1, 1, 1), {"friction": 0.1}),
        ((-1, -1, -1, -1), {"scale": 60.0}),
    ],
)
def test_the_first_action_does_what_it_does_in_box2d(box2d, action, own):
    noise = np.random.default_rng(0).random(2)
    context = box2d.Constants(**{"gravity": 10.0, "friction": 2.5, "scale": 30.0, **own})
    walker = box2d.Walker(context, box2d.luck(noise))
    expected, _, _ = box2d.advance([walker], np.zeros((1, 4), np.float32))
    state = INITIAL(jnp.asarray(noise, jnp.float32), params(**own))
    seen = np.asarray(OBSERVE(state, params(**own)))
    np.testing.assert_allclose(seen, expected[0], atol=0.02)
    action = np.array(action, np.float32)
    expected, reward, _ = box2d.advance([walker], action[None])
    step = STEP(state, jnp.asarray(action), params(**own))
    seen = np.asarray(OBSERVE(step.state, params(**own)))
    np.testing.assert_allclose(seen, expected[0], atol=0.03)
    assert float(step.reward) == pytest.approx(reward[0], abs=0.05)


def test_unguided_it_stands_still_at_little_cost():
    noise = np.random.default_rng(0).random((4, 2))
    end = played(noise, jnp.tile(jnp.array(ENV.idle), (MOST, 1)), params(n=4))
    assert end.alive.all()
    assert ((np.asarray(end.total) > -20.0) & (np.asarray(end.total) < 0.0)).all()


def test_a_walker_that_falls_loses_a_hundred_and_the_episode():
    noise = np.random.default_rng(0).random((4, 2))
    end = played(noise, jnp.ones((250, 4)), params(n=4))
    assert not end.alive.any()
    assert (np.asarray(end.total) < -80.0).all()


def test_every_axis_changes_what_happens():
    noise = np.tile(np.random.default_rng(0).random(2), (4, 1))
    walk = jnp.asarray(np.random.default_rng(1).uniform(-1, 1, (60, 4)), jnp.float32)
    others = ({}, {"gravity": 5.0}, {"friction": 0.1}, {"scale": 20.0})
    own = jax.tree.map(lambda *x: jnp.stack(x), *(params(**other) for other in others))
    angles = np.asarray(played(noise, walk, own).env.angles)
    assert (np.abs(angles[1:] - angles[0]).max(axis=1) > 0.05).all()


def test_an_action_that_is_no_number_ends_the_episode():
    state = INITIAL(jnp.array([0.3, 0.4]), params())
    assert bool(STEP(state, jnp.array([jnp.nan, 0.0, 0.0, 0.0]), params()).terminated)


def test_a_large_hull_lies_on_the_ground_at_once():
    state = INITIAL(jnp.array([0.3, 0.4]), params(scale=1.0))
    step = STEP(state, jnp.zeros(4), params(scale=1.0))
    assert (bool(step.terminated), float(step.reward)) == (True, -100.0)


def test_it_shows_what_box2d_s_environment_shows(box2d):
    walker = box2d.Walker(box2d.Constants(10.0, 2.5, 30.0), lucks(box2d, 1)[0])
    for _ in range(3):
        expected, _, _ = box2d.advance([walker], np.zeros((1, 4), np.float32))
    heights = jnp.asarray(walker.ground[1], jnp.float32)
    heights = jnp.append(heights, heights[-1])
    feet = jnp.array([walker.contact[2], walker.contact[4]])
    none = jnp.zeros(4, jnp.int32), jnp.zeros((4, 4), bool)
    seen = OBSERVE(WalkerState(*_pose(walker), heights, *none, feet), params())
    np.testing.assert_allclose(seen, expected[0], atol=2e-5)
