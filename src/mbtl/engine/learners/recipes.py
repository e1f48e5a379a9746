"""Hyper-parameters as frozen records, and the named recipes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from mbtl.errors import InvalidInput, check_known
from mbtl.plain import short, whole

Activation = Literal["tanh", "relu", "mish"]

_STEPS_PER_CALL = 256
"""A2C and DQN learn every few steps: as many of those as give this many steps are one update."""

_FREE = ("learning_starts",)
"""Whole numbers of recipes that may be 0."""
_SIGNED = ("log_std", "entropy_coef")
"""Numbers of recipes that may be below 0."""
_SHARES = ("gamma", "gae_lambda")
"""Numbers of recipes that may not be above 1."""


def check_lengths(**counts: int) -> None:
    """Refuse numbers that are below 1."""
    for name, value in counts.items():
        if value < 1:
            raise InvalidInput(f"{name} must be >= 1, got {value}")


@dataclass(frozen=True)
class Learner:
    """What the recipes of all algorithms have.

    Attributes:
        unit: what the length of a training counts, "timesteps" or "episodes".
        gamma: discount per decision.
        hidden: widths of the hidden layers of all networks.
        activation: between the layers.
        anneal: the learning rate falls linearly to 0 over a training of known length.

    Raises:
        InvalidInput: a count is below 1, another number is none or below 0, or numbers of a
            subclass do not fit together.
    """

    unit: ClassVar[str]
    gamma: float = 0.99
    hidden: tuple[int, ...] = (64, 64)
    activation: Activation = "tanh"
    anneal: bool = False

    def __post_init__(self) -> None:
        hidden = np.ravel(self.hidden).tolist()  # JSON has a list; a recipe must be hashable
        object.__setattr__(self, "hidden", tuple(whole("hidden", width) for width in hidden))
        check_lengths(hidden=min(self.hidden, default=1))
        for one in fields(self):
            name, value = one.name, getattr(self, one.name)
            if one.type == "int":
                least = 0 if name in _FREE else 1
                if whole(name, value) < least:
                    raise InvalidInput(f"{name} must be >= {least}, got {value}")
            elif one.type == "float":
                lowest = -math.inf if name in _SIGNED else 0.0
                most = 1.0 if name in _SHARES else math.inf
                if not (isinstance(value, Real) and lowest <= float(value) <= most):
                    rule = f"a number >= {lowest:g}" + " and <= 1" * (name in _SHARES)
                    raise InvalidInput(f"{name} must be {rule}, got {short(value)}")

    @property
    def record(self) -> dict[str, object]:
        """JSON-able: what decides the policy."""
        return {**vars(self), "hidden": list(self.hidden)}


@dataclass(frozen=True)
class ActorCritic(Learner):
    """What the recipes of PPO, A2C and TRPO have beside that.

    Attributes:
        gae_lambda: decay of generalised advantage estimation; 1 gives whole returns.
        normalize_advantage: to mean 0 and standard deviation 1 in what is learnt from at once.
        log_std: initial log standard deviation of a Gaussian policy.
    """

    gae_lambda: float = 0.95
    normalize_advantage: bool = False
    log_std: float = 0.0


@dataclass(frozen=True)
class WithCopies(Learner):
    """What the recipes have that learn from copies of an environment, which start again one by one.

    Attributes:
        n_envs: copies of the environment per policy.
        learning_rate: of the optimiser: Adam, or A2C's RMSprop.
        max_grad_norm: gradients of one policy are scaled down to this norm.
    """

    unit: ClassVar[str] = "timesteps"
    n_envs: int = 1
    learning_rate: float = 3e-4
    max_grad_norm: float = 0.5


@dataclass(frozen=True)
class PPORecipe(WithCopies, ActorCritic):
    """Hyper-parameters of PPO; the defaults are those of Stable-Baselines3.

    Attributes:
        n_steps: steps of each copy between two updates.
        batch_size: transitions per gradient step; divides n_envs x n_steps.
        n_epochs: passes over the rollout per update.
        clip_range: trust region of the probability ratio.
        entropy_coef: weight of the entropy bonus.
        value_coef: weight of the value loss.
        adam_eps: Adam's denominator offset.
        standardize: learn from observations with mean 0 and deviation 1; see `units`.

    Raises:
        InvalidInput: a count is below 1, or the minibatches do not fill the rollout.
    """

    n_steps: int = 2048
    batch_size: int = 64
    n_epochs: int = 10
    clip_range: float = 0.2
    entropy_coef: float = 0.0
    value_coef: float = 0.5
    adam_eps: float = 1e-5
    normalize_advantage: bool = True
    standardize: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.update_length % self.batch_size:
            raise InvalidInput(
                f"batch_size must divide n_envs x n_steps = {self.update_length}, "
                f"got {self.batch_size}"
            )

    @property
    def update_length(self) -> int:
        """Environment steps of one policy between two updates."""
        return self.n_envs * self.n_steps


@dataclass(frozen=True)
class A2CRecipe(WithCopies, ActorCritic):
    """Hyper-parameters of A2C, as in `PPORecipe`; the defaults are those of Stable-Baselines3.

    Attributes:
        n_steps: steps of each copy between two gradient steps.
        rms_decay: of RMSprop's mean of squares.
        rms_eps: RMSprop's denominator offset.
        rms_like_tensorflow: RMSprop as it is there, not as in PyTorch; see `a2c.optimizer`.
    """

    n_steps: int = 5
    learning_rate: float = 7e-4
    gae_lambda: float = 1.0
    entropy_coef: float = 0.0
    value_coef: float = 0.5
    rms_decay: float = 0.99
    rms_eps: float = 1e-5
    rms_like_tensorflow: bool = False

    @property
    def rollouts_per_update(self) -> int:
        """Rollouts, each with its gradient step, that the loop sees as one update."""
        return math.ceil(_STEPS_PER_CALL / (self.n_envs * self.n_steps))

    @property
    def update_length(self) -> int:
        """Environment steps of one policy in one call of `a2c.update`."""
        return self.rollouts_per_update * self.n_envs * self.n_steps


@dataclass(frozen=True)
class DQNRecipe(WithCopies):
    """Hyper-parameters of DQN; the defaults are those of Stable-Baselines3 but for the replay.

    (Stable-Baselines3 keeps 1,000,000 transitions; a tenth of it is what fits for many policies.)

    Attributes:
        train_freq: steps of each copy between two rounds of learning.
        gradient_steps: minibatches per round.
        batch_size: transitions per minibatch, drawn with replacement.
        buffer_size: transitions kept for replay, per policy; the oldest are overwritten.
        learning_starts: environment steps of uniformly random actions before the first round.
        target_every: environment steps between two copies of the network to its target.
        exploration_fraction: share of the training in which epsilon falls linearly from 1.
        final_epsilon: probability of a random action afterwards.
        adam_eps: Adam's denominator offset.

    Raises:
        InvalidInput: a count is below 1, or rounds do not fill the replay.
    """

    train_freq: int = 4
    gradient_steps: int = 1
    batch_size: int = 32
    learning_rate: float = 1e-4
    buffer_size: int = 100_000
    learning_starts: int = 100
    target_every: int = 10_000
    exploration_fraction: float = 0.1
    final_epsilon: float = 0.05
    max_grad_norm: float = 10.0
    adam_eps: float = 1e-8
    activation: Activation = "relu"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.buffer_size % self.steps_per_round:
            raise InvalidInput(
                f"buffer_size must be a multiple of n_envs x train_freq = {self.steps_per_round}, "
                f"got {self.buffer_size}; the next is {self._filled(self.steps_per_round)}"
            )

    def _filled(self, rows: int) -> int:
        """The least ring, no smaller than this one, that so many rows at a time fill."""
        return math.ceil(self.buffer_size / rows) * rows

    def spread(self, n_contexts: int) -> DQNRecipe:
        """With a copy of the world per context, and as many gradient steps per step of a copy."""
        more = 1 << max(math.ceil(math.log2(n_contexts / self.n_envs)), 0)
        return replace(
            self,
            n_envs=more * self.n_envs,
            gradient_steps=more * self.gradient_steps,
            buffer_size=self._filled(more * self.steps_per_round),
        )

    @property
    def steps_per_round(self) -> int:
        """Environment steps of one policy between two rounds of learning."""
        return self.n_envs * self.train_freq

    @property
    def rounds_per_update(self) -> int:
        """Rounds that the loop sees as one update."""
        return math.ceil(_STEPS_PER_CALL / self.steps_per_round)

    @property
    def update_length(self) -> int:
        """Environment steps of one policy in one call of `dqn.update`."""
        return self.rounds_per_update * self.steps_per_round


MultiTaskMethod = Literal["ppo", "paco", "moore"]


@dataclass(frozen=True)
class MultiTaskRecipe(PPORecipe):
    """PPO of one policy for all contexts (`mbtl.engine.learners.multitask`).

    Its copies of the environment are shared by all contexts.

    Attributes:
        method: "ppo" (context-conditioned PPO), "paco" or "moore".
        n_parts: parameter sets of PaCo, experts of MOORE; context-conditioned PPO has none.

    Raises:
        UnknownName: no such method.
        InvalidInput: less than one part, or standardised observations for PaCo or MOORE, whose
            vectors are found by a number that must stay as it is.
    """

    method: MultiTaskMethod = "ppo"
    n_parts: int = 5

    def __post_init__(self) -> None:
        super().__post_init__()
        check_known("multi-task method", self.method, get_args(MultiTaskMethod))
        if self.has_vectors and self.standardize:
            raise InvalidInput(
                f"{self.method} cannot learn from standardised observations, got standardize=True; "
                "use the method ppo, or standardize=False"
            )

    @classmethod
    def of(cls, method: MultiTaskMethod, ppo: PPORecipe, n_parts: int = 5) -> MultiTaskRecipe:
        """As a recipe of one source says."""
        return cls(**vars(ppo), method=method, n_parts=n_parts)

    @property
    def has_vectors(self) -> bool:
        """Whether there is a learned vector per context; networks must know then where they are."""
        return self.method != "ppo"


Recipe = PPORecipe | A2CRecipe | DQNRecipe

RECIPES: Mapping[str, Mapping[str, Recipe]] = {
    "PPO": {
        "sb3": PPORecipe(),
        "fast": PPORecipe(
            n_envs=8, n_steps=128, batch_size=128, n_epochs=1, learning_rate=2e-3, anneal=True
        ),
    },
    "A2C": {
        "sb3": A2CRecipe(),
        "fast": A2CRecipe(n_envs=16, learning_rate=3e-3, anneal=True, rms_like_tensorflow=True),
    },
    "DQN": {
        "sb3": DQNRecipe(),
        "fast": DQNRecipe(
            n_envs=8, batch_size=64, learning_rate=1e-3, buffer_size=51_200, target_every=2048
        ),
    },
}
"""Recipes by algorithm and name: `sb3` has Stable-Baselines3's defaults, `fast` ends sooner."""


_SHARED = PPORecipe(
    n_envs=100, n_steps=128, batch_size=512, n_epochs=1, learning_rate=2e-3, anneal=True
)
MULTI_TASK: Mapping[str, PPORecipe] = {
    "CartPole": _SHARED,
    "Pendulum": replace(_SHARED, gamma=0.95, n_epochs=4),
}
"""How a hundred contexts are learnt from, by the class of the environment."""
_SHORTEST = 16
"""Steps of a copy between two updates that `multitask_recipe` leaves."""
_N_PARTS: Mapping[MultiTaskMethod, int] = {"ppo": 1, "paco": 5, "moore": 4}
_AT_ONCE = 4
"""Contexts, an episode in each, from which an update of a policy for several learns at least."""
_A2C_COPIES = 16
"""That A2C needs to learn from several contexts."""
_WIDER = 2
"""Hidden layers of a policy for several contexts, in those of one for one."""


def own_recipe(world: Any) -> PPORecipe | None:
    """How many contexts of this world are learnt from, where it has a recipe of its own."""
    return MULTI_TASK.get(type(getattr(world, "env", world)).__name__)


def multitask_recipe(
    method: MultiTaskMethod, one: PPORecipe, world: Any, n_contexts: int
) -> MultiTaskRecipe:
    """The recipe of one policy for many contexts.

    CartPole and Pendulum have one of their own. Every other world is learnt by that of one source:
    the same update, of more and shorter copies. As many copies as there are contexts, if that
    leaves 16 steps of each: then every update learns from all contexts, by as many gradient steps
    per environment step as for one source.

    Raises:
        UnknownName: no such method.
    """
    n_envs, n_steps = one.n_envs, one.n_steps
    while n_envs < n_contexts and n_steps % 2 == 0 and n_steps > _SHORTEST:
        n_envs, n_steps = 2 * n_envs, n_steps // 2
    ppo = own_recipe(world) or replace(one, n_envs=n_envs, n_steps=n_steps)
    return MultiTaskRecipe.of(method, ppo, _N_PARTS.get(method, 1))


def of_several(one: Any, world: Any, n_contexts: int) -> Any:
    """The recipe of one policy for several contexts, where it is to be as good as it can be.

    Counting steps, layers are twice as wide: what to do depends on one thing more
    (docs/decisions.md). PPO learns as in `multitask_recipe`; CartPole and Pendulum keep theirs. DQN
    has a copy of the world per context, and as many gradient steps per environment step as for one:
    from few copies it learns nothing. A2C has sixteen copies or more.
    Counting episodes, an update of TRPO sees four contexts, or all: by the episode of one, a policy
    is pulled away from all others. What others learn from an episode would shrink with the number
    of updates.
    """
    if isinstance(one, TRPORecipe):
        return replace(one, n_episodes=max(one.n_episodes, min(_AT_ONCE, n_contexts)))
    if isinstance(one, TwinRecipe):
        return one
    if isinstance(one, PPORecipe):
        one = multitask_recipe("ppo", one, world, n_contexts)
        if own_recipe(world) is not None:
            return one
    if isinstance(one, DQNRecipe):
        one = one.spread(n_contexts)
    if isinstance(one, A2CRecipe):
        one = replace(one, n_envs=max(one.n_envs, min(_A2C_COPIES, n_contexts)))
    return replace(one, hidden=tuple(_WIDER * width for width in one.hidden))


def as_wide_as(recipe: Learner, weights: Any) -> Any:
    """The recipe with layers of a network that there is: for one context, or for several.

    Other widths are not its own, and whoever begins a training refuses them.
    """
    given = tuple(bias.shape[-1] for _, bias in weights.actor[:-1])
    known = [tuple(share * width for width in recipe.hidden) for share in (1.0 / _WIDER, 1, _WIDER)]
    return replace(recipe, hidden=given) if given in known else recipe


# ---- whole episodes -----------------------------------------------------------------------------


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
        begin: what a new policy does: a name that the world knows (`rule`); empty: all but zero.
        credit: whose rewards an action is worth (`returns.of_team`).
    """

    critic_gain: float = 0.01
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
    buffer_size: int = 50_000
    exploration_fraction: float = 1.0
    final_epsilon: float = 0.0
    max_grad_norm: float = 10.0


AnyPPO = PPORecipe | EpisodicPPORecipe
AnyDQN = DQNRecipe | EpisodicDQNRecipe
"""From copies, or from whole episodes."""

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
            critic_learning_rate=1e-3, normalize_reward=False, center_reward=False, credit="team"
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
