"""Hyper-parameters of the algorithms that learn from whole episodes of a twin."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

from mbtl.engine.learners.recipes import Activation, ActorCritic, Learner
from mbtl.errors import InvalidInput

Credit = Literal["own", "team"]
"""Whose rewards an action is worth: the agent's until it leaves, or the team's until the end."""


@dataclass(frozen=True)
class TwinRecipe(Learner):
    """What the recipes have that learn from whole episodes.

    Attributes:
        n_episodes: episodes of one policy between two updates.
        normalize_reward: divide rewards by the deviation of discounted returns.
        center_reward: subtract their running mean. Not where lives end by what an agent does: there
            it pays, or costs, to live on.
        hold: decisions for which what is random in an action stays the same. Fresh deviations at
            every decision average out before they come to anything.
    """

    unit: ClassVar[str] = "episodes"
    n_episodes: int = 1
    normalize_reward: bool = False
    center_reward: bool = False
    hold: int = 1

    @property
    def update_length(self) -> int:
        """Episodes of one policy between two updates."""
        return self.n_episodes


@dataclass(frozen=True)
class EpisodicActorCritic(TwinRecipe, ActorCritic):
    """What TRPO and PPO have beside that.

    Attributes:
        critic_gain: of the critic's last layer at the start.
        first_action: mean of a Gaussian policy before the first update, in every dimension.
        begin: what a new policy does: a name that the world knows (`engine.worlds.rules.Rules`);
            empty: its first action.
        credit: whose rewards an action is worth (`returns.of_team`).
    """

    critic_gain: float = 0.01
    first_action: float = 0.0
    begin: str = ""
    credit: Credit = "own"


@dataclass(frozen=True)
class TRPORecipe(EpisodicActorCritic):
    """Hyper-parameters of TRPO on whole episodes; cmdp-spec, 7.4, and the reference's code.

    Attributes:
        max_kl: delta, largest mean KL(old, new) of an update.
        cg_steps: iterations of conjugate gradients.
        damping: added to the diagonal of the Fisher matrix.
        backtracks: most steps of the line search.
        backtrack: factor between them.
        accept: least ratio of the real to the expected improvement.
        critic_learning_rate: Adam's.
        critic_passes: its steps per update, each on all rows.
        clip_actions: learn from the actions that were applied, not from the samples beyond their
            bounds: the gradient is biased, and pulls a mean that has left the bounds back.
    """

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
    clip_actions: bool = True
    normalize_reward: bool = True
    center_reward: bool = True


@dataclass(frozen=True)
class EpisodicPPORecipe(EpisodicActorCritic):
    """Hyper-parameters of PPO on whole episodes; the defaults are those of cmdp-spec, 6.3.

    Those that are not explained here are as in `PPORecipe`.

    Attributes:
        rows: decisions to learn from per update, drawn at random where there are more.
        minibatches: per pass; divides `rows`.
        value_clip: largest move of a value per update.
        kl_coef: first weight of the KL penalty; raised and lowered by the KL of the last update. 0:
            no penalty, for ever.
        target_kl: the update ends when a minibatch is farther than this.

    Raises:
        InvalidInput: a count is below 1, or the minibatches do not fill the rows.
    """

    adam_eps: ClassVar[float] = 1e-8
    rows: int = 8000
    minibatches: int = 40
    n_epochs: int = 10
    learning_rate: float = 1e-4
    anneal: bool = False
    gae_lambda: float = 0.97
    clip_range: float = 0.03
    value_clip: float = 3.0
    value_coef: float = 1.0
    entropy_coef: float = 0.005
    kl_coef: float = 0.1
    target_kl: float = 0.02
    max_grad_norm: float = 1e9
    hidden: tuple[int, ...] = (256, 256, 256, 256)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rows % self.minibatches:
            raise InvalidInput(
                f"minibatches must divide rows = {self.rows}, got {self.minibatches}"
            )

    @property
    def batch_size(self) -> int:
        """Rows per gradient step."""
        return self.rows // self.minibatches


@dataclass(frozen=True)
class EpisodicDQNRecipe(TwinRecipe):
    """Hyper-parameters of DQN on whole episodes; the defaults are the paper's of signals.

    (cmdp-spec, 5; `dqn` says what differs.) Those that are not explained here are as in
    `DQNRecipe`; the target is the network at the beginning of an update.

    Attributes:
        gradient_steps: minibatches per update.
        buffer_size: decisions kept for replay, per policy; the oldest are overwritten.
        exploration_fraction: share of the training in which epsilon falls linearly from 1, update
            by update.
    """

    adam_eps: ClassVar[float] = 1e-8
    gamma: float = 0.75
    hidden: tuple[int, ...] = (400, 400, 400, 400)
    activation: Activation = "mish"
    normalize_reward: bool = True
    gradient_steps: int = 800
    batch_size: int = 100
    learning_rate: float = 1e-3
    anneal: bool = False
    buffer_size: int = 50_000
    exploration_fraction: float = 1.0
    final_epsilon: float = 0.0
    max_grad_norm: float = 10.0


_FAST = EpisodicPPORecipe(
    rows=2048,
    minibatches=8,
    n_epochs=6,
    learning_rate=1e-3,
    gamma=0.95,
    gae_lambda=0.9,
    clip_range=0.2,
    value_clip=1e9,
    value_coef=0.5,
    entropy_coef=0.0,
    kl_coef=0.0,
    target_kl=0.05,
    max_grad_norm=0.5,
    normalize_advantage=True,
    normalize_reward=True,
    critic_gain=1.0,
    hidden=(64, 64),
    log_std=-1.0,
)

_ONE_STEP: Mapping[str, Any] = {
    "minibatches": 1, "n_epochs": 1, "kl_coef": 0.0, "target_kl": math.inf, "value_clip": 1e9,
}  # fmt: skip
"""One step of PPO's loss, by the policy that played: that is A2C's, with Adam."""

TWIN_RECIPES: Mapping[str, Mapping[str, TwinRecipe]] = {
    "TRPO": {
        "paper": TRPORecipe(),
        "team": TRPORecipe(
            critic_learning_rate=1e-3,
            normalize_reward=False,
            center_reward=False,
            credit="team",
        ),
    },
    "A2C": {"fast": replace(_FAST, **_ONE_STEP)},
    "DQN": {
        "paper": EpisodicDQNRecipe(),
        "fast": EpisodicDQNRecipe(gradient_steps=400, hidden=(128, 128), anneal=True),
    },
    "PPO": {
        "paper": EpisodicPPORecipe(),
        "fast": _FAST,
        "glide": replace(
            _FAST,
            n_episodes=4,
            rows=8192,
            minibatches=16,
            n_epochs=4,
            learning_rate=1e-4,
            gamma=0.99,
            gae_lambda=0.99,
            log_std=-2.0,
            begin="glide",
            hold=10,
        ),
    },
}
"""Recipes by algorithm and name; `paper` is the spec's, `fast` ends sooner on a CPU, `glide` begins
with a rule of eco-driving and learns how fast to drive (docs/eco-driving.md)."""
