"""The ring's twin: closed forms, and that nothing depends on the company."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.engine.learners.episodic.episodes import Actor, measures
from mbtl.engine.worlds import random
from mbtl.problems import get_cmdp
from mbtl.seeds import episode_seed
from mbtl.trainers import reference_rows
from mbtl.zoo.cmdps.traffic.twins import RingProblem
from mbtl.zoo.worlds.traffic.ring import RingTwin

NOBODY = Actor((), jnp.zeros((1, 1)))
START, STEP = (jax.jit(method, static_argnums=0) for method in (RingTwin.start, RingTwin.step))


def ring(hold=2.0, **options):
    twin, (params,) = RingProblem("acceleration", **options)([{"hold": hold}])
    return twin, params


def unguided(twin, params, seeds):
    seeds = np.array([seeds], np.uint32)
    decisions = twin.decisions(params)
    found = measures(twin, "tanh", "none", NOBODY, seeds, seeds, params, decisions)
    return np.asarray(found["score"])[0]


# ---- the ring ------------------------------------------------------------------------------------


def test_noise_makes_traffic_stop_and_go_and_an_episode_does_not_depend_on_its_company():
    seeds = np.arange(100)
    found, again = unguided(*ring(), seeds), unguided(*ring(), np.roll(seeds, 30))
    assert 3.0 < found.mean() < 3.3
    assert found.std() > 0.02
    np.testing.assert_array_equal(np.roll(found, 30), again)


def test_a_collision_ends_the_ring_and_is_charged():
    twin, params = ring()
    state = START(twin, jnp.zeros(2, jnp.uint32), params)
    near = state.gap.at[1, 0].set(0.2).at[2, 0].add(state.gap[1, 0] - 0.2)
    moved = STEP(twin, state._replace(gap=near), jnp.zeros((2, 1)), params)
    assert moved.done[:, 0].tolist() == [True, False]
    assert float(moved.reward[0, 0]) == pytest.approx(-100.0, abs=1.0)
    again = STEP(twin, moved.state, jnp.zeros((2, 1)), params)
    assert float(again.reward[0, 0]) == 0.0
    assert not bool(again.done[0, 0])
    np.testing.assert_array_equal(again.state.gap[:, 0], moved.state.gap[:, 0])


def test_after_a_collision_the_cars_stand_for_the_rest_of_the_measured_part():
    """Half of the measured part at the speed of a free flow, the other half at none."""
    twin, params = ring(hold=10.0, noise=0.0, start="uniform")
    twin = replace(twin, warm_up=100, unmeasured=100, total_steps=1_100, speed_factor=0.0)
    drive = jax.jit(twin.drive)
    state = START(twin, jnp.zeros(2, jnp.uint32), params)
    for _ in range(6):
        state = drive(state, params).state
    speed, so_far = float(state.driven[0, 1]), float(twin.score(state)[0])
    near = state.gap.at[1, 0].set(0.2).at[2, 0].add(state.gap[1, 0] - 0.2)
    state = STEP(twin, state._replace(gap=near), jnp.zeros((2, 1)), params).state
    assert state.running.tolist() == [False, True]
    for _ in range(4):
        state = drive(state, params).state
    crashed, whole = np.asarray(twin.score(state))
    assert crashed == pytest.approx(so_far / 2, rel=0.01)
    assert whole == pytest.approx(speed, rel=0.2)


# ---- decisions that last differently long --------------------------------------------------------


def test_a_collision_ends_only_its_own_ring_and_stays_with_the_decision_in_which_it_was():
    twin, each = RingProblem("acceleration", noise=0.0)([{"hold": 1.0}, {"hold": 2.0}])
    twin = replace(twin, warm_up=20, unmeasured=20, total_steps=100)
    params = jax.tree.map(lambda *x: jnp.stack(x), *each)
    beats = twin.decisions(params)
    state = START(twin, jnp.zeros(2, jnp.uint32), params)
    held, done, reward, beat = twin.held(state), [], [], jax.jit(twin.beat, static_argnums=4)
    for now in range(4):
        if now == 2:  # with the second decision of the second ring
            state = state._replace(
                gap=state.gap.at[1, 1].set(0.2).at[2, 1].add(state.gap[1, 1] - 0.2)
            )
        moved, held = beat(state, held, jnp.zeros((2, 1)), params, beats, jnp.int32(now))
        state = moved.state
        done.append(moved.done[:, 0].tolist())
        reward.append(float(moved.reward[1, 0]))
    assert done == [[False, False]] * 3 + [[False, True]]
    assert reward[0] == reward[2] == 0.0  # told with the last beat
    assert reward[3] == pytest.approx(-100.0, abs=1.0)


# ---- random numbers ------------------------------------------------------------------------------


@pytest.mark.parametrize(("draw", "excess"), [(random.normal, 0.0), (random.coins, -1 / 16)])
def test_noise_is_normal_or_nearly_so_and_independent_of_its_neighbours(draw, excess):
    every = jax.vmap(lambda t: draw(jnp.arange(200, dtype=jnp.uint32), 2, t, 40))
    z = np.asarray(every(jnp.arange(150)), float)  # (moments, cars, seeds): 1.2 million
    n = z.size
    assert abs(z.mean()) < 4 / np.sqrt(n)
    assert abs(z.var() - 1.0) < 4 * np.sqrt(2 / n)
    assert abs((z**4).mean() - 3.0 - excess) < 4 * np.sqrt(96 / n)
    for axis in range(3):
        later, earlier = (np.delete(z, k, axis) for k in (0, -1))
        assert abs((later * earlier).mean()) < 4 / np.sqrt(n)


def test_rows_without_a_policy_are_those_of_nobody_and_of_anybody():
    trainer = get_cmdp("ring-acc", engine="jax").trainer_for(eval_episodes=4)
    rows = reference_rows(trainer, [{"hold": 40.0}], [1])
    seeds = [episode_seed(1, episode) for episode in range(4)]
    assert rows["unguided"][0] == pytest.approx(unguided(*ring(40.0), seeds))
    assert rows["random_actions"].shape == (1, 4)
    assert rows["random_actions"].mean() < rows["unguided"].mean()
