"""Hyper-parameters of the algorithms that learn from whole episodes of a twin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mbtl.training.jax.recipes import Activation, check_counts, named, record_of


@dataclass(frozen=True)
class TRPORecipe:
    """Hyper-parameters of TRPO on whole episodes; the defaults are those of cmdp-spec, 7.4.

    Attributes:
        n_episodes: episodes of one policy between two updates.
        gamma: discount per decision.
        gae_lambda: decay of generalised advantage estimation; 1 gives whole returns.
        max_kl: delta, largest mean KL(old, new) of an update.
        cg_steps: iterations of conjugate gradients.
        damping: added to the diagonal of the Fisher matrix.
        backtracks: most steps of the line search.
        backtrack: factor between them.
        accept: least ratio of the real to the expected improvement.
        critic_learning_rate: Adam's.
        critic_passes: its steps per update, each on all rows.
        normalize_reward: centre rewards and divide them by the deviation of discounted returns.
        hidden: widths of the hidden layers of actor and critic.
        log_std: initial log standard deviation of a Gaussian policy.
        activation: between the layers.

    Raises:
        InvalidInput: a count is below 1.
    """

    n_episodes: int = 1
    gamma: float = 0.999
    gae_lambda: float = 1.0
    max_kl: float = 0.01
    cg_steps: int = 10
    damping: float = 0.1
    backtracks: int = 10
    backtrack: float = 0.5
    accept: float = 0.1
    critic_learning_rate: float = 1e-4
    critic_passes: int = 1
    normalize_reward: bool = True
    hidden: tuple[int, ...] = (64, 64)
    log_std: float = 0.0
    activation: Activation = "tanh"

    def __post_init__(self) -> None:
        check_counts(self, "n_episodes", "cg_steps", "backtracks", "critic_passes")

    @property
    def record(self) -> dict[str, object]:
        """JSON-able: what decides the policy."""
        return record_of(self)


TWIN_RECIPES: Mapping[str, Mapping[str, TRPORecipe]] = {"TRPO": {"paper": TRPORecipe()}}
"""Recipes by algorithm and name."""


def twin_recipe_named(algorithm: str, name: str) -> TRPORecipe:
    """The recipe called `name` of `TWIN_RECIPES`.

    Raises:
        UnknownName: there is none.
    """
    return named(TWIN_RECIPES, algorithm, name)
