"""A policy of Stable-Baselines3 that learns from the actions that are applied.

The library samples from a Gaussian, clips the sample to the bounds for the environment and learns
from the sample. Once the mean is beyond a bound all samples are clipped to it: they earn the same,
and nothing pulls the mean back. Learning from the clipped action does (the gradient is biased).
"""

from __future__ import annotations

from typing import Any

from mbtl.errors import needs

with needs("stable-baselines3", "train"):
    import torch
    from gymnasium.spaces import Box
    from stable_baselines3.common.policies import ActorCriticPolicy


class AppliedMlpPolicy(ActorCriticPolicy):  # type: ignore[misc]  # stable_baselines3 is untyped for our checker
    """`MlpPolicy` of the on-policy algorithms; differs where actions have bounds."""

    def forward(self, obs: Any, deterministic: bool = False) -> tuple[Any, Any, Any]:
        """Actions within their bounds, values, and log probabilities of these actions."""
        actions, values, log_prob = super().forward(obs, deterministic)
        if isinstance(self.action_space, Box):
            low, high = (
                torch.as_tensor(bound, device=actions.device)
                for bound in (self.action_space.low, self.action_space.high)
            )
            actions = actions.clamp(low, high)
            log_prob = self.action_dist.log_prob(actions)  # just set, to that of `obs`
        return actions, values, log_prob
