"""Hyper-parameters as frozen records, and the named recipes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

from mbtl.errors import InvalidInput, unknown_name


@dataclass(frozen=True)
class PPORecipe:
    """Hyper-parameters of PPO; the defaults are those of Stable-Baselines3.

    Attributes:
        n_envs: copies of the environment per policy.
        n_steps: steps of each copy between two updates.
        batch_size: transitions per gradient step; divides n_envs x n_steps.
        n_epochs: passes over the rollout per update.
        learning_rate: Adam's.
        gamma: discount per step.
        gae_lambda: decay of generalised advantage estimation.
        clip_range: trust region of the probability ratio.
        entropy_coef: weight of the entropy bonus.
        value_coef: weight of the value loss.
        max_grad_norm: gradients of one policy are scaled down to this norm.
        adam_eps: Adam's denominator offset.
        normalize_advantage: to mean 0 and standard deviation 1 in each minibatch.
        anneal: learning rate falls linearly to 0 over the training.
        hidden: widths of the hidden layers of actor and critic.
        log_std: initial log standard deviation of a Gaussian policy.

    Raises:
        InvalidInput: a count is below 1, or the minibatches do not fill the rollout.
    """

    n_envs: int = 1
    n_steps: int = 2048
    batch_size: int = 64
    n_epochs: int = 10
    learning_rate: float = 3e-4
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    entropy_coef: float = 0.0
    value_coef: float = 0.5
    max_grad_norm: float = 0.5
    adam_eps: float = 1e-5
    normalize_advantage: bool = True
    anneal: bool = False
    hidden: tuple[int, ...] = (64, 64)
    log_std: float = 0.0

    def __post_init__(self) -> None:
        for name in ("n_envs", "n_steps", "batch_size", "n_epochs"):
            if getattr(self, name) < 1:
                raise InvalidInput(f"{name} must be >= 1, got {getattr(self, name)}")
        if self.steps_per_update % self.batch_size:
            raise InvalidInput(
                f"batch_size must divide n_envs x n_steps = {self.steps_per_update}, "
                f"got {self.batch_size}"
            )

    @property
    def steps_per_update(self) -> int:
        """Environment steps of one policy between two updates."""
        return self.n_envs * self.n_steps

    @property
    def record(self) -> dict[str, object]:
        """JSON-able: what decides the policy."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return values | {"hidden": list(self.hidden)}


RECIPES: Mapping[str, PPORecipe] = {
    "sb3": PPORecipe(),
    "fast": PPORecipe(
        n_envs=8, n_steps=128, batch_size=256, n_epochs=4, learning_rate=1e-3, anneal=True
    ),
}


def recipe_named(name: str) -> PPORecipe:
    """The recipe called `name`.

    Raises:
        UnknownName: there is none.
    """
    if name not in RECIPES:
        raise unknown_name("PPO recipe", name, RECIPES)
    return RECIPES[name]
