"""Export: the acting part of a Stable-Baselines3 policy as a plain numpy `MLPPolicy`.

What can be exported: flat `Box` observations, dense layers with tanh, relu or mish, and one of

    actor-critic policies (PPO, A2C, TRPO, ...)   action or logits: policy_net, action_net
    DQN                                           values: q_net
    SAC, TQC                                      mean, squashed: latent_pi, mu
    TD3, DDPG                                     action, squashed: mu

Every export is compared with the original on random observations and withheld if it differs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbtl.arrays import Array
from mbtl.errors import needs
from mbtl.portfolio import BoxHead, DiscreteHead, MLPPolicy
from mbtl.trainers.adapted import AdaptedPolicy

_PROBES = 96
_NEAR_TIE = 1e-4  # relative; float32 and float64 may order two outputs this close differently


def export_mlp(model: Any) -> MLPPolicy | None:
    """The policy of `model` in numpy, acting exactly as `model.predict(..., deterministic=True)`.

    Discrete actions are the same except where two outputs agree to float32 rounding; continuous
    ones agree to float32 rounding.

    Args:
        model: a Stable-Baselines3 algorithm, or a policy of its trainer.

    Returns:
        The export, or None when the network is of another kind (convolutions, recurrence, masks,
        dictionaries of observations, ...).

    Raises:
        MissingExtra: Stable-Baselines3 is not installed.
    """
    if isinstance(model, AdaptedPolicy):
        inner = export_mlp(model.model)
        return None if inner is None else model.exported(inner)
    parts, head = _acting_layers(model), _head(model)
    dense = None if parts is None else _dense(parts)
    if dense is None or head is None or not _flat_observations(model.policy):
        return None
    weights, biases, activation = dense
    shape = tuple(model.observation_space.shape)
    if weights[0].shape[1] != int(np.prod(shape)) or len(biases[-1]) != head.n_outputs:
        return None
    policy = MLPPolicy(weights, biases, activation, shape, head)  # type: ignore[arg-type]
    return policy if _agrees(policy, model) else None


def _acting_layers(model: Any) -> list[Any] | None:
    """Modules from features to outputs, in order; without a final squashing."""
    with needs("stable-baselines3", "train"):
        from stable_baselines3.common.policies import ActorCriticPolicy
        from stable_baselines3.dqn.policies import DQNPolicy
        from stable_baselines3.sac.policies import SACPolicy
        from stable_baselines3.td3.policies import TD3Policy
    policy = model.policy
    name = type(policy).__module__
    if "recurrent" in name or "mask" in name:
        return None
    if isinstance(policy, ActorCriticPolicy):
        return [*policy.mlp_extractor.policy_net, policy.action_net]
    if isinstance(policy, DQNPolicy):
        return [*policy.q_net.q_net]
    if isinstance(policy, SACPolicy) or name.startswith("sb3_contrib.tqc"):
        return [*policy.actor.latent_pi, policy.actor.mu]
    if isinstance(policy, TD3Policy):
        return [*policy.actor.mu][:-1]
    return None


def _flat_observations(policy: Any) -> bool:
    from gymnasium.spaces import Box
    from stable_baselines3.common.torch_layers import FlattenExtractor

    actor = next((getattr(policy, n) for n in ("actor", "q_net") if hasattr(policy, n)), policy)
    return isinstance(policy.observation_space, Box) and isinstance(
        actor.features_extractor, FlattenExtractor
    )


def _head(model: Any) -> DiscreteHead | BoxHead | None:
    from gymnasium.spaces import Box, Discrete, MultiDiscrete

    space, policy = model.action_space, model.policy
    is_distribution = hasattr(policy, "action_net")
    if isinstance(space, Discrete):
        return DiscreteHead((int(space.n),), scalar=True, samples=is_distribution)
    if isinstance(space, MultiDiscrete) and space.nvec.ndim == 1:
        return DiscreteHead(tuple(map(int, space.nvec)), scalar=False, samples=is_distribution)
    if isinstance(space, Box):
        low, high = (np.array(bound, dtype=np.float32) for bound in (space.low, space.high))
        log_std = None if model.use_sde else getattr(policy, "log_std", None)
        if log_std is not None:
            log_std = log_std.detach().cpu().numpy().copy()
        return BoxHead(low, high, squash=bool(policy.squash_output), log_std=log_std)
    return None


def _dense(modules: Sequence[Any]) -> tuple[tuple[Any, ...], tuple[Any, ...], str] | None:
    """Weights, biases and the one activation of linear layers with that activation between them."""
    from torch import nn

    activations: dict[Any, str] = {nn.Tanh: "tanh", nn.ReLU: "relu", nn.Mish: "mish"}
    linear, between = modules[::2], modules[1::2]
    kinds = {type(module) for module in between} or {nn.Tanh}
    if len(modules) % 2 == 0 or not all(
        type(m) is nn.Linear and m.bias is not None for m in linear
    ):
        return None
    if len(kinds) != 1 or not kinds <= set(activations):
        return None
    weights = tuple(m.weight.detach().cpu().numpy().copy() for m in linear)
    biases = tuple(m.bias.detach().cpu().numpy().copy() for m in linear)
    return weights, biases, activations[kinds.pop()]


def _agrees(policy: MLPPolicy, model: Any) -> bool:
    rng = np.random.default_rng(0)
    scale = np.repeat([0.1, 1.0, 10.0], _PROBES // 3).reshape(
        -1, *[1] * len(policy.observation_shape)
    )
    probes = (rng.normal(size=(_PROBES, *policy.observation_shape)) * scale).astype(np.float32)
    ours, _ = policy.predict(probes)
    theirs, _ = model.predict(probes, deterministic=True)
    if isinstance(policy.head, BoxHead):
        return bool(np.allclose(ours, theirs, rtol=1e-3, atol=1e-4))
    differs = (ours != theirs).reshape(_PROBES, -1).any(axis=1)
    return not bool((differs & _clear(policy, policy.outputs(probes))).any())


def _clear(policy: MLPPolicy, outputs: Array) -> Any:
    """(B,) True where every choice has a winner by more than rounding."""
    assert isinstance(policy.head, DiscreteHead)
    clear = np.ones(len(outputs), dtype=bool)
    for block in np.split(outputs, np.cumsum(policy.head.sizes)[:-1], axis=1):
        if block.shape[1] > 1:
            second, first = np.sort(block, axis=1)[:, -2:].T
            clear &= first - second > _NEAR_TIE * (1.0 + np.abs(first))
    return clear
