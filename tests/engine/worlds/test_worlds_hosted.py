"""A simulator that steps whole batches on the host is trained and evaluated as one in jax."""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

import mbtl.engine.learners as engine
from mbtl.engine import worlds
from mbtl.zoo.cmdps import pendulum
from mbtl.zoo.worlds import Pendulum

CALLS = []
"""Axes of each native step."""


@dataclass(frozen=True)
class NumpyPendulum:
    """The pendulum in numpy: whole batches by one call, in float64 within a step."""

    horizon: int = 200
    shapes = (("t", ()), ("w", ()))
    time_limit = "truncation"
    action = Pendulum().action
    n_features = 3
    n_noise = 2
    max_return = 0.0
    params = Pendulum().params

    def initial(self, noise, params):
        spread = 2.0 * noise - 1.0
        state = {"t": math.pi * spread[..., 0], "w": spread[..., 1]}
        return state, self._seen(state)

    def step(self, state, action, params):
        CALLS.append(np.shape(state["t"]))
        t, w, u = state["t"], state["w"], np.clip(action[..., 0], -2.0, 2.0)
        wrapped = (t + math.pi) % (2.0 * math.pi) - math.pi
        reward = -(wrapped**2 + 0.1 * w**2 + 0.001 * u**2)
        pushed = w + params.gravity_gain * np.sin(t) + params.torque_gain * u
        w = np.clip(pushed, -params.max_speed, params.max_speed)
        state = {"t": t + w * params.timestep, "w": w}
        return state, self._seen(state), reward, np.zeros(np.shape(t), bool)

    def _seen(self, state):
        return np.stack([np.cos(state["t"]), np.sin(state["t"]), state["w"]], axis=-1)


NATIVE = worlds.hosted(NumpyPendulum(horizon=30))
TRACED = worlds.Solo(Pendulum(horizon=30))
TINY = engine.PPORecipe(n_envs=4, n_steps=32, batch_size=64, n_epochs=2, learning_rate=1e-3)


def params_of(masses):
    peers = [pendulum.Pendulum({"mass": mass}) for mass in masses]
    return worlds.stack_params(NATIVE, [p.constants for p in peers], [p.visible for p in peers])


def test_single_steps_are_those_of_the_traced_world():
    params = jax.tree.map(jnp.float32, params_of([0.2, 1.0, 5.0]))
    drawn = TRACED.draws(np.arange(3, dtype=np.uint32))
    ours, theirs = NATIVE.start(drawn, params), TRACED.start(drawn, params)
    native, traced = jax.jit(NATIVE.step), jax.jit(TRACED.step)
    for k in range(10):
        action = jnp.full((3, 1, 1), 3.0 * math.cos(k))
        mine, peer = native(ours, action, params), traced(theirs, action, params)
        np.testing.assert_allclose(mine.reward, peer.reward, rtol=1e-4, atol=1e-5)
        ours, theirs = mine.state, peer.state
        seen = [world.observe(s, params).obs for world, s in ((NATIVE, ours), (TRACED, theirs))]
        np.testing.assert_allclose(*seen, rtol=1e-4, atol=1e-4)


def test_one_native_call_steps_all_policies_and_copies_and_they_learn_the_same():
    """Same random numbers, so two updates later only rounding differs; episodes end on the way."""
    params = params_of([0.5, 2.0])
    CALLS.clear()
    ours, theirs = (
        engine.train(world, TINY, [3, 7], params, 256, checkpoint_every=256, checkpoint_episodes=2)
        for world in (NATIVE, TRACED)
    )
    assert len(CALLS) == 2 * 32 + 30  # of two rollouts, and of an evaluation
    assert {int(np.prod(axes)) for axes in CALLS} == {2 * 4, 2 * 2}
    for a, b in zip(*(jax.tree.leaves(t.best) for t in (ours, theirs)), strict=True):
        np.testing.assert_allclose(a, b, atol=2e-3)
    np.testing.assert_allclose(ours.best_return, theirs.best_return, rtol=0.02)
