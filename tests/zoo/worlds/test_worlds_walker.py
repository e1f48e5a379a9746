"""The walker in jax: Box2D's step by step, and what its parts promise.

All tests share three programs, of eight walkers at once: compiling them is what takes time.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.zoo.worlds.walker import BipedalWalker, WalkerParams, WalkerState
from mbtl.zoo.worlds.walker import walker as twin

ENV = BipedalWalker()
START, STEP, OBSERVE = (jax.jit(jax.vmap(m)) for m in (ENV.initial, ENV.step, ENV.observe))
N = 8
NOMINAL = {"gravity": 10.0, "friction": 2.5, "scale": 30.0}
NOISE = np.random.default_rng(0).random((N, 2)).astype(np.float32)


def params(*contexts):
    """Of eight walkers, the last of which are in the last context; what is not told is nominal."""
    each = [{**NOMINAL, **context} for context in (contexts or [{}])]
    each += each[-1:] * (N - len(each))
    columns = (jnp.array([one[name] for one in each], jnp.float32) for name in NOMINAL)
    return WalkerParams(*columns, jnp.zeros((N, 0)))


def played(actions, own, noise=NOISE):
    """(states, which have not ended, returns) after these actions, (t, 4), which are all one's."""
    state, alive, total = START(noise, own), np.ones(N, bool), np.zeros(N)
    for action in actions:
        step = STEP(state, jnp.tile(jnp.asarray(action, jnp.float32), (N, 1)), own)
        state, total = step.state, total + alive * np.asarray(step.reward)
        alive &= ~np.asarray(step.terminated)
    return state, alive, total


@pytest.fixture(scope="module")
def box2d():
    pytest.importorskip("Box2D", reason="the envs extra is not installed")
    from mbtl.zoo.cmdps.locomotion import walker as theirs

    return theirs


def lucks(box2d, n):
    return np.random.default_rng(0).random((n, box2d.ROUGH + box2d.PATCHES + 1))


def poses(walkers):
    """Centres, angles and speeds that Box2D's walkers have."""
    bodies = [walker.bodies for walker in walkers]
    centre = jnp.array([tuple(own[0].worldCenter) for own in bodies], jnp.float32)
    angles = jnp.array([[body.angle for body in own] for own in bodies], jnp.float32)
    moving = [[(*tuple(b.linearVelocity), b.angularVelocity) for b in own] for own in bodies]
    return centre, angles, jnp.array(moving, jnp.float32)


def test_the_ground_is_box2d_s(box2d):
    heights = jax.jit(twin.heights)
    for luck in lucks(box2d, 3):
        for scale in (3.0, 30.0, 300.0):
            ours = heights(jnp.asarray(luck[:-1], jnp.float32), jnp.float32(scale))
            np.testing.assert_allclose(ours, box2d.heights(luck, scale), atol=1e-4)


def test_sine_and_cosine_are_numpy_s():
    angles = np.linspace(-300.0, 300.0, 100_001, dtype=np.float32)
    found = jax.jit(twin.sin_cos)(angles)
    exact = np.float64(angles)
    np.testing.assert_allclose(found, [np.sin(exact), np.cos(exact)], atol=2e-7)


def test_a_step_is_box2d_s(box2d):
    """From Box2D's own states, under a gait with noise: without contact, and with; and the view."""
    heuristics = pytest.importorskip("gymnasium.envs.box2d.bipedal_walker").BipedalWalkerHeuristics
    rng, off, on, own = np.random.default_rng(0), [], [], params()
    luck, gaits = lucks(box2d, N), [heuristics() for _ in range(N)]
    walkers = [box2d.Walker(box2d.Constants(**NOMINAL), one) for one in luck]
    for gait in gaits:
        gait.a = np.zeros(4)
    heights = jnp.asarray([box2d.heights(one, 30.0) for one in luck], jnp.float32)
    seen, _, _ = box2d.advance(walkers, np.zeros((N, 4), np.float32))
    first, touching = jnp.zeros((N, 4), jnp.int32), jnp.zeros((N, 4, 4), bool)
    over = np.zeros(N, bool)
    for number in range(60):
        feet = jnp.array([[walker.contact[2], walker.contact[4]] for walker in walkers])
        state = WalkerState(*poses(walkers), heights, first, touching, feet)
        if number > 2:  # before, Box2D's legs are not where its joints hold them
            np.testing.assert_allclose(OBSERVE(state, own)[~over], seen[~over], atol=2e-5)
        gait = [one.step_heuristic(its) for one, its in zip(gaits, seen, strict=True)]
        action = np.clip(gait + rng.normal(0.0, 0.3, (N, 4)), -1.0, 1.0).astype(np.float32)
        new = STEP(state, jnp.asarray(action), own).state
        first, touching = new.first, new.touching
        seen, _, ended = box2d.advance(walkers, action)
        over |= ended
        _, angles, moving = poses(walkers)
        error = np.stack([
            np.abs(new.angles - angles).max(axis=1), np.abs(new.moving - moving).max(axis=(1, 2))
        ], axis=1)  # fmt: skip
        if number > 2:
            stands = np.asarray(touching).any(axis=(1, 2))
            off.extend(error[~stands & ~over])
            on.extend(error[stands & ~over])
    assert min(len(off), len(on)) > 60
    np.testing.assert_array_less(np.quantile(off, 0.8, axis=0), [0.01, 0.01])
    np.testing.assert_array_less(np.median(on, axis=0), [0.005, 0.01])
    np.testing.assert_array_less(np.quantile(on, 0.8, axis=0), [0.03, 0.5])


def test_the_first_action_does_what_it_does_in_box2d(box2d):
    tried = [
        ((0, 0, 0, 0), {}),
        ((1, 1, 1, 1), {}),
        ((-1, 0.5, 1, -1), {}),
        ((1, -1, -1, 1), {"gravity": 2.0}),
        ((1, 1, 1, 1), {"friction": 0.1}),
        ((-1, -1, -1, -1), {"scale": 60.0}),
    ]
    own = params(*(context for _, context in tried))
    actions = np.array([action for action, _ in tried] + [tried[-1][0]] * 2, np.float32)
    state = START(NOISE, own)
    before, step = OBSERVE(state, own), STEP(state, jnp.asarray(actions), own)
    after = OBSERVE(step.state, own)
    for i, (_, context) in enumerate(tried):
        walker = box2d.Walker(box2d.Constants(**{**NOMINAL, **context}), box2d.luck(NOISE[i]))
        expected, _, _ = box2d.advance([walker], np.zeros((1, 4), np.float32))
        np.testing.assert_allclose(before[i], expected[0], atol=0.02)
        expected, reward, _ = box2d.advance([walker], actions[[i]])
        np.testing.assert_allclose(after[i], expected[0], atol=0.03)
        assert float(step.reward[i]) == pytest.approx(reward[0], abs=0.05)


def test_unguided_it_stands_still_at_little_cost_and_one_that_falls_loses_a_hundred():
    _, alive, total = played([ENV.idle] * 300, params())
    assert alive.all()
    assert ((total > -6.0) & (total < 2.0)).all()
    _, alive, total = played(np.ones((250, 4)), params())
    assert not alive.any()
    assert (total < -80.0).all()


def test_every_axis_changes_what_happens():
    walk = np.random.default_rng(1).uniform(-1, 1, (60, 4))
    own = params({}, {"gravity": 5.0}, {"friction": 0.1}, {"scale": 20.0})
    angles = np.asarray(played(walk, own, NOISE[[0] * N])[0].angles)
    assert (np.abs(angles[1:] - angles[0]).max(axis=1) > 0.05).all()


def test_an_episode_ends_with_an_action_that_is_no_number_or_a_hull_that_lies_on_the_ground():
    own = params({}, {}, {"scale": 1.0})
    action = jnp.zeros((N, 4)).at[1, 0].set(jnp.nan)
    step = STEP(START(NOISE, own), action, own)
    assert step.terminated[:3].tolist() == [False, True, True]
    assert float(step.reward[2]) == -100.0
