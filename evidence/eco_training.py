"""Trainings of eco-driving that differ in one thing, all in one program (`eco_causes.py`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from eco_play import TWIN, play, stacked
from measure import note

import jax  # isort: skip  # after eco_play, which sets the flags of jax
import jax.numpy as jnp

from mbtl.engine.learners import loop, networks
from mbtl.engine.learners.episodic import learning
from mbtl.engine.learners.episodic.episodes import actor_of, import_actor, watched
from mbtl.engine.learners.episodic.episodes import measures as of_episodes
from mbtl.engine.learners.episodic.recipes import TWIN_RECIPES
from mbtl.engine.worlds.world import of_simulations
from mbtl.zoo.cmdps.traffic.twins import EcoProblem
from mbtl.zoo.worlds.traffic.eco import EcoTwin

SEEDS = 2
"""Trainings per way; a way's seeds are the same as another's."""
LESSONS = ("speeds", "glide")
"""Sets of ways that advise speeds."""
AGENTS = 16
"""Places of agents: in these contexts more cars are hardly ever controlled at once."""
FRESH = 5000
"""Seeds of evaluations begin here."""

RECIPE = replace(TWIN_RECIPES["PPO"]["fast"], gamma=0.99, gae_lambda=0.97)
"""Of the preset `standard` as it was."""


class Way(NamedTuple):
    """What a training may differ in.

    Attributes:
        reward: that it learns from.
        first_action: mean action before the first update [m/s^2].
        log_std: of exploration, before the first update.
    """

    reward: str = "paper"
    first_action: float = 0.0
    log_std: float = -1.0


_GLIDE = TWIN_RECIPES["PPO"]["glide"]
RECIPES = {
    "first action": RECIPE,
    "exploration": RECIPE,
    "speeds": replace(_GLIDE, begin="", first_action=1.0),
    "glide": _GLIDE,
}
"""Of each set of ways; the last two advise speeds."""

WAYS = {
    "first action": {
        "as it was": Way(),
        "+ first action 3": Way(first_action=3.0),
        "+ deviation 1": Way(first_action=3.0, log_std=0.0),
        "+ delay": Way("delay", 3.0, 0.0),
        "+ platoon": Way("platoon", 3.0, 0.0),
    },
    "exploration": {
        "1, deviation 1": Way(first_action=1.0, log_std=0.0),
        "1, deviation 1, platoon": Way("platoon", 1.0, 0.0),
        "1, deviation 2": Way(first_action=1.0, log_std=0.7),
        "1, deviation 2, delay": Way("delay", 1.0, 0.7),
        "1, deviation 2, platoon": Way("platoon", 1.0, 0.7),
    },
    "speeds": {
        "from the limit, delay": Way("delay", 1.0, -1.0),
        "from the limit, platoon": Way("platoon", 1.0, -1.0),
        "from the limit, road": Way("road", 1.0, -1.0),
    },
    "glide": {
        "from the rule, platoon": Way("platoon", 1.0, -2.0),
        "from the rule, road": Way("road", 1.0, -2.0),
    },
}
"""Each set is one program. In the first, a way adds to those before it; names of the second say the
first action, the deviation and, where it is not the paper's, the reward. The others say where a
training begins, and its reward."""


@dataclass(frozen=True)
class Mixed(EcoTwin):
    """A twin whose simulations, policy by policy, are taught by rewards of their own."""

    taught: tuple[str, ...] = ()

    def _rewards(self, state: Any, *arguments: Any) -> Any:
        each = state.row.shape[1] // len(self.taught)
        found: Any = None
        for kind in sorted(set(self.taught)):
            reward, done = EcoTwin._rewards(replace(self, reward=kind), state, *arguments)
            mine = np.repeat([own == kind for own in self.taught], each)
            found = reward if found is None else jnp.where(mine, reward, found)
        return found, done


def trained(context: Mapping[str, float], ways: str, episodes: int) -> tuple[Any, Any]:
    """Weights of `SEEDS` policies per way, before and after training in one context."""
    chosen, recipe = WAYS[ways].values(), RECIPES[ways]
    many = [way for way in chosen for _ in range(SEEDS)]
    base = EcoProblem(agents=AGENTS, score="paper")([{}])[0]
    if ways in LESSONS:
        base = base.lesson("speed")
    own = {field.name: getattr(base, field.name) for field in fields(base)}
    twin = Mixed(**own, taught=tuple(way.reward for way in many))
    params = stacked([context] * len(many), 1)

    each = [
        learning.init(
            twin,
            replace(recipe, first_action=way.first_action, log_std=way.log_std),
            [100 + seed],
            params,
        )
        for way in chosen
        for seed in range(SEEDS)
    ]
    first = jax.tree.map(lambda *x: jnp.concatenate(x), *[one.weights for one in each])
    after = loop.train(
        twin,
        recipe,
        [100 + k % SEEDS for k in range(len(many))],
        params,
        episodes,
        acting="mean",
        weights=first,
        checkpoint_every=max(24, episodes // 10),
        checkpoint_episodes=4,
        on_block=lambda block: note(f"{block.steps} of {block.total} episodes"),
    )
    return first, after.state.weights


def acting(weights: Any, context: Mapping[str, float], seeds: int, ways: str) -> dict[str, Any]:
    """Measures (policies, seeds) of policies by their mean actions; and `sampled` scores."""
    n = len(weights.log_std)
    twin = TWIN.lesson("speed") if ways in LESSONS else TWIN

    def rule(obs: Any, _: Any) -> Any:
        mine = obs.reshape(n, seeds, *obs.shape[1:])
        told = jax.vmap(partial(networks.apply, activation="tanh"))(weights.actor, mine)
        return networks.to_environment(told, twin.action)[..., 0].reshape(obs.shape[:-1])

    drawn = np.tile(np.arange(FRESH, FRESH + seeds, dtype=np.uint32), (n, 1))
    params = stacked([context] * n, seeds)
    found = play(rule, twin, jnp.asarray(drawn.reshape(-1)), params, jnp.zeros((drawn.size, 0)))
    actor = actor_of(weights)._replace(critic=())
    sampled = of_episodes(
        twin, "tanh", "sampled", actor, jnp.asarray(drawn), twin.draws(drawn), params, twin.horizon
    )["score"]
    shaped = {name: np.asarray(x, float).reshape(n, seeds) for name, x in found.items()}
    return shaped | {"sampled": np.asarray(sampled, float)}


def measures(
    twin: Any, params: Any, policies: Sequence[Any] | None, episodes: int
) -> dict[str, Any]:
    """Measures (contexts, episodes) of policies in their own context; None: unguided."""
    n = len(params.visible)
    drawn = jnp.tile(jnp.arange(FRESH, FRESH + episodes, dtype=jnp.uint32), (n, 1))
    network = None if policies is None else import_actor(list(policies)).network
    found = _measured(twin, network, drawn, of_simulations(params, episodes))
    return {name: np.asarray(x, float).reshape(n, episodes) for name, x in found.items()}


@partial(jax.jit, static_argnums=0)
def _measured(twin: Any, network: Any, drawn: Any, params: Any) -> Any:
    def one(_: int, state: Any) -> Any:
        if network is None:
            return twin.drive(state, params).state
        seen, _ = watched(twin, "tanh", params, drawn.shape, (network,), state)
        told = networks.to_environment(seen.found[0], twin.action)
        return twin.step(state, told.reshape(-1, *told.shape[2:]), params).state

    first = twin.start(drawn.reshape(-1), params)
    return twin.measures(jax.lax.fori_loop(0, twin.horizon, one, first))
