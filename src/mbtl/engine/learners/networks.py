"""Small actor and critic networks as plain arrays, and what the actor's outputs mean.

A network is a tuple of layers (weight (n_in, n_out), bias (n_out,)) with an activation between.
Functions here take one policy and any leading axes of observations; `jax.vmap` over policies turns
each layer of all policies into one batched matrix product, which is what makes training them
together fast.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from mbtl.engine.learners.recipes import Activation, ActorCritic, Learner
from mbtl.engine.worlds.environments import Box, Discrete, Tree
from mbtl.engine.worlds.world import World
from mbtl.errors import InvalidInput

Network = tuple[tuple[jax.Array, jax.Array], ...]

BENDS: Mapping[Activation, Callable[[jax.Array], jax.Array]] = {
    "tanh": jnp.tanh, "relu": jax.nn.relu, "mish": jax.nn.mish,
}  # fmt: skip
"""The function between the layers."""


class Weights(NamedTuple):
    """Everything a policy learns.

    Attributes:
        actor: observation -> logits, or the mean of a Gaussian.
        critic: observation -> value, (..., 1); () where there is none.
        log_std: (d,) logarithm of the Gaussian's standard deviation; (0,) for discrete actions.
    """

    actor: Network
    critic: Network
    log_std: jax.Array


def n_outputs(action: Discrete | Box) -> int:
    """Outputs of the actor: one per option, or one per dimension."""
    return action.n if isinstance(action, Discrete) else len(action.low)


def init_weights(
    seed: int,
    n_inputs: int,
    action: Discrete | Box,
    hidden: Sequence[int],
    log_std: float = 0.0,
    critic_gain: float = 1.0,
) -> Weights:
    """Orthogonal weights with the gains of Stable-Baselines3.

    sqrt(2) for hidden layers, 0.01 for the last of the actor, `critic_gain` for the last of the
    critic. Made by numpy in float32: the same on every device, and jax 0.10 can hang in a batch of
    QR factorisations on a CPU (waiting for a task that never starts; 100 policies of 64-64 on two
    cores).
    """
    rng = np.random.default_rng(seed)
    d = len(action.low) if isinstance(action, Box) else 0
    return Weights(
        _init_network(rng, [n_inputs, *hidden, n_outputs(action)], last_gain=0.01),
        _init_network(rng, [n_inputs, *hidden, 1], last_gain=critic_gain),
        cast(jax.Array, np.full(d, log_std, dtype=np.float32)),
    )


def fresh(world: World, recipe: Learner, seeds: Sequence[int], params: Tree) -> list[Weights]:
    """Weights of each policy as its recipe has them: with a critic, or values of actions alone.

    Raises:
        InvalidInput: there are values of actions, and those are not discrete.
    """
    n_inputs = world.n_features + params.visible.shape[-1]
    if not isinstance(recipe, ActorCritic):
        widths = [n_inputs, *recipe.hidden, options(world)]
        return [init_q_network(seed, widths) for seed in seeds]
    gain = getattr(recipe, "critic_gain", 1.0)
    own = (n_inputs, world.action, recipe.hidden, recipe.log_std, gain)
    return [init_weights(seed, *own) for seed in seeds]


def begun(given: Any, fresh: Callable[[], Sequence[Weights]]) -> Any:
    """Weights to begin with: those given, and fresh networks for what is missing in them.

    Nothing is given at all, or no critic, which no exported policy has.
    """
    if given is not None and given.critic:
        return given
    new = stack(fresh())
    return new if given is None else given._replace(critic=new.critic)


def options(world: World) -> int:
    """How many actions there are.

    Raises:
        InvalidInput: they are not discrete.
    """
    if not isinstance(world.action, Discrete):
        raise InvalidInput(
            f"DQN must have discrete actions, got a box of {len(world.action.low)} dimensions; use "
            "PPO or A2C"
        )
    return world.action.n


def init_q_network(seed: int, widths: Sequence[int]) -> Weights:
    """A network of action values as the actor; uniform in +-1 / sqrt(n_in), PyTorch's default.

    `widths` are those of the observation, the hidden layers and the actions; there is no critic.
    """
    rng = np.random.default_rng(seed)

    def layer(n_in: int, n_out: int) -> Any:
        bound = 1.0 / math.sqrt(n_in)
        shapes = (n_in, n_out), (n_out,)
        return tuple(rng.uniform(-bound, bound, shape).astype(np.float32) for shape in shapes)

    pairs = pairwise(widths)
    no_std = cast(jax.Array, np.zeros(0, dtype=np.float32))
    return Weights(tuple(layer(*pair) for pair in pairs), (), no_std)


def stack(each: Sequence[Tree]) -> Any:
    """Weights of several policies as one tree of jax arrays, leading axis."""
    return jax.device_put(jax.tree.map(lambda *leaves: np.stack(leaves), *each))


def _init_network(rng: np.random.Generator, widths: Sequence[int], last_gain: float) -> Network:
    gains = [math.sqrt(2.0)] * (len(widths) - 2) + [last_gain]
    pairs = zip(gains, widths[:-1], widths[1:], strict=True)
    return tuple(
        (orthogonal(rng, n_in, n_out, gain), cast(jax.Array, np.zeros(n_out, dtype=np.float32)))
        for gain, n_in, n_out in pairs
    )


def orthogonal(rng: np.random.Generator, n_in: int, n_out: int, gain: float) -> Any:
    """(n_in, n_out) with orthogonal columns or rows of length `gain`, uniformly distributed."""
    tall = rng.standard_normal((max(n_in, n_out), min(n_in, n_out)))
    q, r = np.linalg.qr(tall)
    q *= np.sign(np.diag(r))
    return (gain * (q if n_in >= n_out else q.T)).astype(np.float32)


def apply(
    network: Network | Callable[[jax.Array, Activation], jax.Array],
    observations: jax.Array,
    activation: Activation = "tanh",
) -> jax.Array:
    """(..., n_inputs) -> (..., n_outputs); a network that is no list of layers knows how itself."""
    if callable(network):
        return network(observations, activation)
    bend = BENDS[activation]
    x = observations
    for weight, bias in network[:-1]:
        x = bend(x @ weight + bias)
    weight, bias = network[-1]
    return x @ weight + bias


def action_noise(key: jax.Array, shape: tuple[int, ...], action: Discrete | Box) -> jax.Array:
    """Random numbers for `sample`: one uniform per choice, or a normal per dimension."""
    if isinstance(action, Discrete):
        return jax.random.uniform(key, shape)
    return jax.random.normal(key, (*shape, len(action.low)))


def sample(
    outputs: jax.Array, log_std: jax.Array, noise: jax.Array, action: Discrete | Box
) -> jax.Array:
    """Action from the distribution: an integer by inversion, or mean + std noise (not clipped)."""
    if isinstance(action, Discrete):
        reached = jnp.cumsum(jax.nn.softmax(outputs), axis=-1)[..., :-1] <= noise[..., None]
        return reached.sum(axis=-1)
    return outputs + jnp.exp(log_std) * noise


def mode(outputs: jax.Array, action: Discrete | Box) -> jax.Array:
    """Most likely action, within the box."""
    if isinstance(action, Discrete):
        return jnp.argmax(outputs, axis=-1)
    return to_environment(outputs, action)


def to_environment(actions: jax.Array, action: Discrete | Box) -> jax.Array:
    """What is applied: vectors are clipped to the box, while learning sees the raw sample."""
    if isinstance(action, Discrete):
        return actions
    return jnp.clip(actions, jnp.asarray(action.low), jnp.asarray(action.high))


def log_prob(
    outputs: jax.Array, log_std: jax.Array, actions: jax.Array, action: Discrete | Box
) -> jax.Array:
    """Log probability (density) of `actions`, summed over dimensions: (...)."""
    if isinstance(action, Discrete):
        # a sum over a mask, not a gather: gathers with batched indices are slow on a CPU
        chosen = actions[..., None] == jnp.arange(action.n)
        return jnp.where(chosen, jax.nn.log_softmax(outputs), 0.0).sum(axis=-1)
    z = (actions - outputs) * jnp.exp(-log_std)
    return (-0.5 * z * z - log_std - 0.5 * math.log(2.0 * math.pi)).sum(axis=-1)


def entropy(outputs: jax.Array, log_std: jax.Array, action: Discrete | Box) -> jax.Array:
    """Entropy of the distribution [nat]: (...) for discrete actions, scalar for a Gaussian."""
    if isinstance(action, Discrete):
        logs = jax.nn.log_softmax(outputs)
        return -(jnp.exp(logs) * logs).sum(axis=-1)
    return (0.5 + 0.5 * math.log(2.0 * math.pi) + log_std).sum(axis=-1)


def kl(
    old: jax.Array,
    old_log_std: jax.Array,
    new: jax.Array,
    new_log_std: jax.Array,
    action: Discrete | Box,
) -> jax.Array:
    """(...) KL(old, new) of action distributions, from outputs (..., m) and log deviations (d,)."""
    if isinstance(action, Discrete):
        logs = jax.nn.log_softmax(old)
        return (jnp.exp(logs) * (logs - jax.nn.log_softmax(new))).sum(axis=-1)
    ratio = jnp.exp(2.0 * (old_log_std - new_log_std))
    apart = jnp.square((old - new) * jnp.exp(-new_log_std))
    return (new_log_std - old_log_std + 0.5 * (ratio + apart - 1.0)).sum(axis=-1)
