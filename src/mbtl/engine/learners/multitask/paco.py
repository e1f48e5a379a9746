"""PaCo: a network per context, composed of a few shared parameter sets.

Sun, Zhang, Xu, Tomizuka: "PaCo: Parameter-Compositional Multi-Task Reinforcement Learning",
NeurIPS 2022. All parameters of the network of context c are

    theta_c = sum_k w_ck Phi_k        K parameter sets Phi, one compositional vector w_c per context

for actor and critic alike, which share w. Every context's loss moves Phi, and w_c is moved by the
loss of its own context alone.

What differs from the paper: it learns by PPO, not SAC; networks also see the visible features;
vectors are interpolated between contexts (`table.py`) and begin as hat functions of the axis
(from random vectors it learnt much less). Tasks whose loss explodes are not masked and their
vectors not reset, as SAC needs it: PPO clips its objective and its gradients, and no training
diverged.

Notation (shapes): N contexts, K parameter sets, o numbers of an observation that the network sees.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np

from mbtl.engine.learners import networks
from mbtl.engine.learners.multitask.table import initial_table, rows_at
from mbtl.engine.learners.networks import Network
from mbtl.engine.learners.recipes import Activation, MultiTaskRecipe
from mbtl.engine.worlds.world import Solo


class Composed(NamedTuple):
    """A network whose parameters depend on the place, the last number of an observation.

    Attributes:
        sets: layers (K, n_in, n_out) and (K, n_out).
        vectors: (N, K) compositional vectors.
    """

    sets: Network
    vectors: jax.Array

    def __call__(self, observations: jax.Array, activation: Activation) -> jax.Array:
        """(..., o + 1) -> (..., n_outputs)."""
        mixture = rows_at(self.vectors, observations[..., -1])
        bend = networks.BENDS[activation]
        x = observations[..., :-1]
        for weight, bias in self.sets[:-1]:
            x = bend(_composed_layer(mixture, x, weight, bias))
        return _composed_layer(mixture, x, *self.sets[-1])


class PaCoWeights(NamedTuple):
    """Everything that is learned: parameter sets, and (N, K) vectors that actor and critic share.

    `actor` and `critic` are networks as elsewhere; `log_std` is the same in all contexts.
    """

    actor_sets: Network
    critic_sets: Network
    log_std: jax.Array
    vectors: jax.Array

    @property
    def actor(self) -> Composed:
        """Observation with place -> logits, or the mean of a Gaussian."""
        return Composed(self.actor_sets, self.vectors)

    @property
    def critic(self) -> Composed:
        """Observation with place -> value."""
        return Composed(self.critic_sets, self.vectors)


def init_weights(
    world: Solo, recipe: MultiTaskRecipe, seed: int, n_contexts: int, n_inputs: int
) -> PaCoWeights:
    """K independent networks as `networks.init_weights` makes them, and hats as vectors."""
    seeds = np.random.SeedSequence(seed).generate_state(recipe.n_parts)
    how = (n_inputs, world.action, recipe.hidden, recipe.log_std)
    each = [networks.init_weights(int(s), *how) for s in seeds]
    sets: Any = jax.tree.map(lambda *leaves: np.stack(leaves), *each)
    vectors: Any = initial_table(n_contexts, recipe.n_parts)
    return PaCoWeights(sets.actor, sets.critic, each[0].log_std, vectors)


def _composed_layer(
    mixture: jax.Array, x: jax.Array, weight: jax.Array, bias: jax.Array
) -> jax.Array:
    """Sum_k w_k (x W_k + b_k), a set at a time: one product over all sets is slower on a CPU."""
    out = mixture @ bias
    for k in range(len(weight)):
        out = out + mixture[..., k, None] * (x @ weight[k])
    return out
