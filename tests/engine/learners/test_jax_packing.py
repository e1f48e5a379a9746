"""Agents packed before the networks: who is where, and that nobody is lost or confused."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.engine.learners import networks
from mbtl.engine.learners.episodic.episodes import Actor, measures, record
from mbtl.engine.worlds import random
from mbtl.engine.worlds.environments import Box
from mbtl.engine.worlds.world import Moved, Seeded, Seen, everyone

BOX = Box((-1.0,), (1.0,))
SHARES = (0.0, 0.1, 0.6, 1.0)
"""Of places that are taken, one moment after another."""


class State(NamedTuple):
    """Moments so far, and what was done in them."""

    seed: jax.Array
    moment: jax.Array
    total: jax.Array


class Params(NamedTuple):
    """Nothing but what is seen of it."""

    visible: jax.Array


@dataclass(frozen=True)
class Crossing(Seeded):
    """Places are taken at random, every agent sees numbers of its own, and actions add up."""

    agents: int = 12
    action: Box = BOX
    n_features: int = 3
    time_limit: str = "truncation"
    params: type = Params

    def decisions(self, params):
        return 8

    def start(self, seeds, params):
        return State(seeds, jnp.int32(0), jnp.zeros(len(seeds)))

    def acting(self, state):
        draw = random.uniform(state.seed, 1, state.moment, self.agents).T
        return draw < jnp.array(SHARES)[state.moment % len(SHARES)]

    def views(self, state, params, simulation, place):
        own = state.seed[simulation].astype(jnp.float32)
        columns = (own, place, state.moment, params.visible[simulation, 0])
        return jnp.stack(
            [0.1 * jnp.float32(column) for column in jnp.broadcast_arrays(*columns)], -1
        )

    def observe(self, state, params):
        return everyone(self, state, params)

    def step(self, state, action, params):
        acting, told = self.acting(state), action[..., 0]
        reward = jnp.where(acting, told, 0.0)
        total = state.total + (reward * (1 + jnp.arange(self.agents))).sum(axis=1)
        return Moved(state._replace(moment=state.moment + 1, total=total), reward, ~acting)

    def score(self, state):
        return state.total


@dataclass(frozen=True)
class Everybody(Crossing):
    """The same, of which nothing but all can be seen."""

    views = None

    def observe(self, state, params):
        return Seen(
            Crossing.views(self, state, params, *jnp.indices(self.acting(state).shape)),
            self.acting(state),
        )


def setting(policies=2, episodes=3):
    each = [networks.init_weights(i, 4, BOX, (8,)) for i in range(policies)]
    weights = networks.stack(each)
    seeds = np.arange(1, 1 + policies * episodes, dtype=np.uint32).reshape(policies, episodes)
    params = Params(jnp.arange(policies * episodes, dtype=jnp.float32)[:, None])
    return Actor(weights.actor, weights.log_std, weights.critic), seeds, params


recorded = jax.jit(record, static_argnums=(0, 1, 2))


def test_packed_agents_live_as_if_networks_had_seen_all_places():
    actor, seeds, params = setting()
    packed = recorded(Crossing(), "tanh", 8, actor, seeds, params)
    every = recorded(Everybody(), "tanh", 8, actor, seeds, params)
    acting = np.asarray(packed.acting)
    np.testing.assert_array_equal(acting, every.acting)
    assert 0.3 < acting.mean() < 0.6
    for name in ("outputs", "action", "value", "reward"):
        a, b = np.asarray(getattr(packed, name)), np.asarray(getattr(every, name))
        np.testing.assert_allclose(a[acting], b[acting], atol=1e-6)
    np.testing.assert_allclose(packed.score, every.score, rtol=1e-5)
    mine = np.asarray(packed.last_acting)
    np.testing.assert_allclose(packed.last_value[mine], every.last_value[mine], atol=1e-6)
    for policy in range(2):
        own = acting[policy]
        seen = [np.asarray(x.obs[policy])[np.asarray(x.row[policy])[own]] for x in (packed, every)]
        np.testing.assert_array_equal(*seen)
    for how in ("mean", "sampled"):
        found = [
            measures(twin, "tanh", how, actor, seeds, seeds, params, 8)["score"]
            for twin in (Crossing(), Everybody())
        ]
        np.testing.assert_allclose(*found, rtol=1e-5)
    np.testing.assert_allclose(found[0], packed.score, rtol=1e-5)  # sampled, as recorded
