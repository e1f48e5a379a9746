"""Numpy copies against the models they were made from."""

import numpy as np
import pytest
from gymnasium import spaces
from training_envs import Guess, GuessBits, GuessDict, GuessPair, cartpole, pendulum

from mbtl.portfolio import BoxHead, MLPPolicy
from mbtl.trainers import export_mlp
from mbtl.trainers.algorithms import algorithm_class

NORMAL = {"length": 0.5, "mass": 1.0}


def untrained(algorithm, env, policy="MlpPolicy", **settings):
    return algorithm_class(algorithm)(policy, env, seed=3, **settings)


def observations(model, n=2000):
    shape = model.observation_space.shape
    return np.random.default_rng(8).normal(scale=2.0, size=(n, *shape)).astype(np.float32)


def assert_same_actions(exported, model):
    batch = observations(model)
    ours, theirs = exported.predict(batch)[0], model.predict(batch, deterministic=True)[0]
    assert ours.shape == theirs.shape
    assert ours.dtype.kind == theirs.dtype.kind
    if isinstance(exported.head, BoxHead):
        assert ours == pytest.approx(theirs, abs=2e-5)
        assert np.std(theirs) > 0
    else:
        assert np.array_equal(ours, theirs)
        assert len(np.unique(theirs)) > 1
    single = exported.predict(batch[0])[0]
    assert single.shape == model.predict(batch[0], deterministic=True)[0].shape


@pytest.mark.parametrize(
    ("algorithm", "make_env"),
    [
        *[(name, cartpole) for name in ("PPO", "A2C", "TRPO", "DQN")],
        *[(name, pendulum) for name in ("PPO", "A2C", "SAC", "TD3", "DDPG", "TQC")],
        ("PPO", GuessPair),
    ],
)
def test_export_acts_as_the_model(algorithm, make_env):
    model = untrained(algorithm, make_env(NORMAL))
    exported = export_mlp(model)
    assert isinstance(exported, MLPPolicy)
    assert_same_actions(exported, model)


@pytest.mark.parametrize("net_arch", [[], [8], [16, 16, 16], {"pi": [4], "vf": [32]}])
def test_any_depth_and_relu(net_arch):
    import torch

    kwargs = {"net_arch": net_arch, "activation_fn": torch.nn.ReLU}
    model = untrained("PPO", cartpole(NORMAL), policy_kwargs=kwargs)
    exported = export_mlp(model)
    assert exported.activation == "relu" or not net_arch
    assert_same_actions(exported, model)


def test_gaussian_spread_is_exported_unless_it_depends_on_the_state():
    model = untrained("PPO", pendulum(NORMAL), policy_kwargs={"log_std_init": -1.5})
    assert export_mlp(model).head.log_std == pytest.approx([-1.5])
    model = untrained("PPO", pendulum(NORMAL), use_sde=True)
    assert export_mlp(model).head.log_std is None
    assert_same_actions(export_mlp(model), model)


def test_observations_of_several_axes_are_flattened():
    class Grid(Guess):
        observation_space = spaces.Box(-1, 1, (2, 3), np.float32)

    model = untrained("PPO", Grid({}))
    exported = export_mlp(model)
    assert exported.observation_shape == (2, 3)
    assert_same_actions(exported, model)


def test_other_networks_are_not_exported():
    import torch
    from stable_baselines3.common.torch_layers import FlattenExtractor

    class Doubling(FlattenExtractor):
        def forward(self, observations):
            return 2.0 * super().forward(observations)

    class Pixels(Guess):
        observation_space = spaces.Box(0, 255, (4, 4, 3), np.uint8)

    assert export_mlp(untrained("PPO", Pixels({}))) is None  # the library divides by 255
    elu = {"activation_fn": torch.nn.ELU}
    subclass = {"features_extractor_class": Doubling}
    assert export_mlp(untrained("PPO", cartpole(NORMAL), policy_kwargs=elu)) is None
    assert export_mlp(untrained("PPO", cartpole(NORMAL), policy_kwargs=subclass)) is None
    assert export_mlp(untrained("PPO", GuessDict({}), "MultiInputPolicy")) is None
    assert export_mlp(untrained("PPO", GuessBits({}))) is None
    assert export_mlp(untrained("RecurrentPPO", cartpole(NORMAL), "MlpLstmPolicy")) is None
    assert export_mlp(untrained("MaskablePPO", cartpole(NORMAL))) is None


def test_export_is_a_copy():
    model = untrained("PPO", cartpole(NORMAL))
    exported = export_mlp(model)
    before = exported.weights[0].copy()
    with __import__("torch").no_grad():
        model.policy.mlp_extractor.policy_net[0].weight.add_(1.0)
    assert np.array_equal(exported.weights[0], before)
