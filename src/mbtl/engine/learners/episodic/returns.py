"""Advantages of agents that come and go, and rewards brought to one scale."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mbtl.engine.learners.descent import mean_of
from mbtl.engine.learners.episodic.episodes import Episodes
from mbtl.engine.learners.recipes import EpisodicActorCritic, TwinRecipe
from mbtl.engine.worlds.environments import Tree


class Returns(NamedTuple):
    """Running statistics over all decisions so far.

    Attributes:
        count: decisions seen.
        reward_mean: of the raw rewards.
        mean: of the discounted sum of past rewards, as Stable-Baselines3's `VecNormalize` keeps it;
            of centred ones where they are centred.
        variance: of the same.
    """

    count: jax.Array
    reward_mean: jax.Array
    mean: jax.Array
    variance: jax.Array

    @classmethod
    def empty(cls) -> Returns:
        """Nothing seen."""
        zero = jnp.float32(0.0)
        return cls(zero, zero, zero, zero)

    def updated(self, recipe: TwinRecipe, lived: Episodes) -> Returns:
        """With more episodes of one policy."""
        weight = lived.acting.astype(jnp.float32)
        n = weight.sum()
        both = jnp.maximum(self.count + n, 1.0)
        share = n / both
        reward_mean = self.reward_mean + share * (mean_of(lived.reward, weight) - self.reward_mean)
        rewards = jnp.where(lived.acting, _centred(recipe, lived.reward, reward_mean), 0.0)

        def forward(past: jax.Array, now: tuple[jax.Array, jax.Array]) -> Any:
            total = recipe.gamma * past + now[0]
            return jnp.where(now[1], 0.0, total), total

        _, discounted = jax.lax.scan(forward, jnp.zeros_like(rewards[0]), (rewards, lived.done))
        mean = mean_of(discounted, weight)
        variance = mean_of(jnp.square(discounted - mean), weight)
        apart = mean - self.mean
        within = (1.0 - share) * self.variance + share * variance
        variance = within + share * (1.0 - share) * jnp.square(apart)
        return Returns(self.count + n, reward_mean, self.mean + share * apart, variance)

    def scaled(self, recipe: TwinRecipe, reward: jax.Array) -> jax.Array:
        """Rewards as they are learnt from."""
        reward = _centred(recipe, reward, self.reward_mean)
        if recipe.normalize_reward:
            reward = reward * jax.lax.rsqrt(self.variance + 1e-8)
        return reward


class Memory(NamedTuple):
    """What a policy keeps between updates beside its weights.

    Attributes:
        moments: of Adam.
        returns: statistics of the rewards.
        kl_coef: of PPO, the weight of its penalty.
        replay: of DQN, (N, 2 f + 3) ring: seen before, seen after, action, raw reward, the life
            ended.
        kept: of DQN, decisions that have entered it.
    """

    moments: Tree
    returns: Returns
    kl_coef: Tree = ()
    replay: Tree = ()
    kept: Tree = ()


def advantages(
    recipe: EpisodicActorCritic, returns: Returns, lived: Episodes
) -> tuple[jax.Array, jax.Array, Returns]:
    """Generalised advantage estimates along each agent's life, or along the team's.

    delta = r + gamma V(next) - V(obs). A life that has ended is worth nothing more; one that the
    end of the episode cut off is worth V of what its agent saw last. A team (`of_team`) lives
    until the episode ends, and an agent's advantage is what the team's return exceeds V(obs) by.

    Returns:
        (D, E, A) advantages, (D, E, A) targets of the critic, and the statistics after.
    """
    own_value = lived.value
    if recipe.credit == "team":
        lived = of_team(lived)
    returns = returns.updated(recipe, lived)
    reward = jnp.where(lived.acting, returns.scaled(recipe, lived.reward), 0.0)
    value = lived.value
    last = jnp.where(lived.last_acting, lived.last_value, 0.0)
    following = jnp.concatenate([value[1:], last[None]])
    alive = ~lived.done
    delta = reward + recipe.gamma * jnp.where(alive, following, 0.0) - value

    def back(later: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        # the form of this sum and of that in `rollout` decides the last bit of kept policies
        advantage = now[0] + recipe.gamma * recipe.gae_lambda * jnp.where(now[1], later, 0.0)
        return advantage, advantage

    _, advantage = jax.lax.scan(back, jnp.zeros_like(delta[0]), (delta, alive), reverse=True)
    target = advantage + value
    if recipe.credit == "team":
        advantage = target - own_value
    return advantage, target, returns


def of_team(lived: Episodes) -> Episodes:
    """The same episodes as the team lives through them: one reward, one value, no end before all.

    Where agents share one reward, what one does is worth what the team earns until the episode
    ends: credited with its own life only, an agent that drives on is paid less than one that stays
    and sees others arrive.

    Its reward and value are the means of those of the agents who act, in every place.
    """

    def shared(x: jax.Array, who: jax.Array) -> jax.Array:
        total = jnp.where(who, x, 0.0).sum(axis=-1, keepdims=True)
        mean = total / jnp.maximum(who.sum(axis=-1, keepdims=True), 1)
        return jnp.broadcast_to(mean, x.shape)

    someone = lived.last_acting.any(axis=-1, keepdims=True)
    return lived._replace(
        reward=shared(lived.reward, lived.acting),
        value=shared(lived.value, lived.acting),
        acting=jnp.ones_like(lived.acting),
        done=jnp.zeros_like(lived.done),
        last_value=shared(lived.last_value, lived.last_acting),
        last_acting=jnp.broadcast_to(someone, lived.last_acting.shape),
    )


def _centred(recipe: TwinRecipe, reward: jax.Array, mean: jax.Array) -> jax.Array:
    """Less their running mean, where the recipe says so."""
    return reward - mean if recipe.center_reward else reward
