"""Contexts whose decisions last differently long are played together as each is alone."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.engine.learners import networks
from mbtl.engine.learners.episodic.episodes import Actor, measures, record
from mbtl.zoo.cmdps.traffic.twins import RampProblem, RingProblem


@pytest.mark.long
@pytest.mark.parametrize("obs", ["fresh", "stale"])
@pytest.mark.parametrize(("problem", "warm_up"), [(RingProblem, 20), (RampProblem, 600)])
def test_several_holds_live_together_as_they_do_alone(problem, warm_up, obs):
    contexts = [{"hold": hold} for hold in (1.0, 3.0, 4.0)]
    twin, each = problem("acceleration", obs=obs, visibility="multiplier")(contexts)
    twin = replace(twin, warm_up=warm_up, unmeasured=20, total_steps=100)
    together = jax.tree.map(lambda *x: jnp.stack(x), *each)
    seeds = np.arange(6, dtype=np.uint32).reshape(3, 2)
    inputs = twin.n_features + 1
    weights = networks.stack(
        [networks.init_weights(i, inputs, twin.action, (8,)) for i in range(3)]
    )
    actor = Actor(weights.actor, weights.log_std, weights.critic)
    params = jax.tree.map(lambda x: jnp.repeat(x, 2, axis=0), together)
    beats = twin.decisions(together)
    assert beats == (10, 12, 10)  # three holds of 4 s, of 1 s each, are the longest episode
    recorded = jax.jit(record, static_argnums=(0, 1, 2))
    mixed = recorded(twin, "tanh", beats, actor, seeds, params)
    judged = measures(twin, "tanh", "mean", actor, seeds, seeds, params, beats)["score"]
    for p, own in enumerate(each):
        some = jax.tree.map(lambda x, p=p: x[p : p + 1], actor)
        count, its = twin.decisions(own), seeds[p : p + 1]
        alone, later = recorded(twin, "tanh", count, some, its, own), slice(10 - count, None)
        assert not mixed.acting[p, : 10 - count].any()
        np.testing.assert_array_equal(mixed.acting[p, later], alone.acting[0])
        told = np.asarray(alone.acting[0])
        assert told.sum() >= 2 * count
        for name in ("outputs", "action", "value", "reward", "done"):
            found, wanted = getattr(mixed, name)[p, later], getattr(alone, name)[0]
            np.testing.assert_allclose(found[told], wanted[told], atol=1e-4)
        for name in ("score", "last_value", "last_acting"):
            np.testing.assert_allclose(getattr(mixed, name)[p], getattr(alone, name)[0], atol=1e-4)
        own_score = measures(twin, "tanh", "mean", some, its, its, own, count)["score"]
        np.testing.assert_allclose(judged[p], own_score[0], atol=1e-4)
