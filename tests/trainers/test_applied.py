"""Learning from applied actions: within their bounds, with probabilities of their own."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

import torch
from gymnasium.spaces import Box, Discrete
from training_envs import pendulum

from mbtl.errors import InvalidInput
from mbtl.trainers import SB3Trainer
from mbtl.trainers.applied import AppliedMlpPolicy

SEEN = Box(-1.0, 1.0, (2,), np.float32)


def policy(actions):
    torch.manual_seed(0)
    return AppliedMlpPolicy(SEEN, actions, lambda _: 1e-3)


@torch.no_grad()
def test_actions_are_within_their_bounds_and_so_are_their_probabilities():
    bounded = policy(Box(-0.5, 0.2, (1,), np.float32))
    seen = torch.zeros(200, 2)
    actions, values, log_prob = bounded(seen)
    assert float(actions.min()) == -0.5
    assert float(actions.max()) == pytest.approx(0.2)
    assert len(set(actions.flatten().tolist())) > 20
    torch.testing.assert_close(log_prob, bounded.get_distribution(seen).log_prob(actions))
    torch.testing.assert_close(values, bounded.predict_values(seen))


@torch.no_grad()
def test_choices_are_as_they_were():
    torch.manual_seed(1)
    actions, _, log_prob = policy(Discrete(3))(torch.zeros(50, 2))
    assert set(actions.tolist()) == {0, 1, 2}
    assert log_prob.exp().tolist() == pytest.approx([1 / 3] * 50, abs=0.05)


def trained(**settings):
    few = {"n_steps": 64, "batch_size": 64, "n_epochs": 1}
    trainer = SB3Trainer(pendulum, timesteps=64, hyperparameters=few, **settings)
    return trainer.train([{"mass": 1.0}], 0).policy


def test_the_trainer_uses_it_where_actions_are_learnt_by_their_probability():
    assert type(trained(clip_actions=True).policy) is AppliedMlpPolicy
    assert type(trained().policy) is not AppliedMlpPolicy
    few = {"learning_starts": 1_000, "buffer_size": 1_000}
    trainer = SB3Trainer(
        pendulum, timesteps=8, algorithm="SAC", hyperparameters=few, clip_actions=True
    )
    assert type(trainer.train([{"mass": 1.0}], 0).policy.policy) is not AppliedMlpPolicy


def test_a_policy_of_ones_own_is_not_replaced():
    with pytest.raises(InvalidInput, match="goes with policy='MlpPolicy'"):
        trained(policy="MultiInputPolicy", clip_actions=True)
