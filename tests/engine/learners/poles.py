"""CartPoles to learn on, and how policies and trees of arrays are compared."""

import jax
import numpy as np

from mbtl.engine import worlds
from mbtl.zoo.cmdps import cartpole


def params_of(env, lengths):
    """Parameters of a CartPole with the axes of `lengths`, (P,) or (P, N)."""
    flat = [cartpole.CartPole({"length": length}) for length in np.ravel(lengths)]
    constants = [cartpole.derive(one.features) for one in flat]
    stacked = worlds.stack_params(env, constants, [one.visible for one in flat])
    return jax.tree.map(lambda x: x.reshape(*np.shape(lengths), *x.shape[1:]), stacked)


def first(tree):
    """The first policy's."""
    return jax.tree.map(lambda x: jax.numpy.asarray(x[0]), tree)


def single(algorithm, env, recipe, seed=3):
    """State and parameters of one policy."""
    params = jax.tree.map(lambda x: jax.numpy.asarray(x, "float32"), params_of(env, [0.4]))
    return first(algorithm.init(env, recipe, [seed], params)), first(params)


def same(one, other):
    """Whether all leaves are, bit for bit."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


def assert_same(one, other):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(a, b)


def apart(one, other):
    """How far the weights of two policies are from each other."""
    return max(abs(a - b).max() for a, b in zip(one.weights, other.weights, strict=True))


def same_policy(one, other):
    return all(np.array_equal(a, b) for a, b in zip(one.weights, other.weights, strict=True))
