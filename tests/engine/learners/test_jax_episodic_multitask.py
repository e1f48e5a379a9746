"""One policy for all contexts of a twin: which ones an update meets, and whole trainings."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mbtl.engine.learners.episodic.learning import contexts_met
from mbtl.engine.learners.recipes import EpisodicDQNRecipe, EpisodicPPORecipe, of_several
from mbtl.problems import get_cmdp


def test_every_episode_is_in_a_context_of_its_own_and_all_have_their_turn():
    seeds = jnp.array([7, 8], jnp.uint32)
    meets = jax.jit(contexts_met, static_argnums=(2, 3))
    met = np.array([meets(seeds, jnp.uint32(u), 5, 3) for u in range(400)])
    assert met.shape == (400, 2, 3)
    assert all(len(set(one)) == 3 for update in met for one in update)
    assert not np.array_equal(met[:, 0], met[:, 1])  # each policy draws its own
    for policy in (0, 1):
        counts = np.bincount(met[:, policy].reshape(-1), minlength=5)
        assert (abs(counts - 240) < 5 * np.sqrt(400 * 0.6 * 0.4)).all()
    more = np.array(contexts_met(seeds, jnp.uint32(0), 5, 12))  # more episodes than contexts
    assert (np.sort(np.bincount(more[0])) == [2, 2, 2, 3, 3]).all()


@pytest.mark.parametrize(("given", "holds", "met"), [(1, 1, 1), (1, 3, 3), (1, 6, 4), (6, 2, 6)])
def test_an_update_for_several_contexts_sees_four_of_them_or_all(given, holds, met):
    trainer = get_cmdp("ring-vel", engine="jax").trainer_for(
        "quick", episodes=8, hyperparameters={"n_episodes": given}
    )
    growing = trainer._growing([[{"hold": float(hold)} for hold in range(1, holds + 1)]], [0])
    assert (growing.recipe.n_episodes, growing.whole) == (met, -(-8 // met))


def test_what_others_learn_from_an_episode_stays():
    assert of_several(EpisodicDQNRecipe(), None, 40) == EpisodicDQNRecipe()
    assert of_several(EpisodicPPORecipe(), None, 40) == EpisodicPPORecipe()


@pytest.mark.long
def test_one_policy_learns_to_calm_rings_of_several_holds():
    contexts = [{"hold": 1.0}, {"hold": 4.0}]
    trainer = get_cmdp("ring-vel", engine="jax", visibility="multiplier").trainer_for(
        "quick", episodes=360, hyperparameters={"n_episodes": 6}
    )
    policy = replace(trainer, eval_episodes=5).train(contexts, 0).policy
    assert trainer.evaluate(policy, contexts, [2, 3]).mean() > 3.5  # unguided: 3.15
