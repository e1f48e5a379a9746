"""The table of the small problems: which worlds, axes and recipes.

Strategies are told apart by many problems, not by good ones: differences between rules on twenty
matrices are noise. So each of these is small, and they differ in what decides between trainings:
physics, sensors, what a policy sees of the context, how long a training is, the algorithm, and
whether an axis turns the meaning of an action around.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Literal

from mbtl.contexts import Context, ContextSpace, Linear
from mbtl.engine.world_trainer import WorldTrainer
from mbtl.problems import CMDP

SOURCES = 16
"""Contexts of a problem of one axis; of two or three, 4 on each."""

Algorithm = Literal["ppo", "a2c", "dqn"]
Length = Literal["long", "short"]

_SHAPES: Mapping[Algorithm, Mapping[str, Any]] = {
    "ppo": {"n_envs": 8, "n_steps": 128, "batch_size": 128, "n_epochs": 2},
    # A2C is PPO with one pass, one minibatch and no clipping
    "a2c": {"n_envs": 16, "n_steps": 16, "batch_size": 256, "n_epochs": 1, "clip_range": 1e9},
    "dqn": {"n_envs": 8, "batch_size": 64, "gradient_steps": 4, "buffer_size": 25_600,
            "target_every": 512, "exploration_fraction": 0.2},
}  # fmt: skip
_SETTINGS: tuple[tuple[bool, Length, Algorithm], ...] = (
    (True, "long", "ppo"),
    (True, "short", "a2c"),
    (False, "long", "a2c"),
    (False, "short", "ppo"),
    (True, "long", "dqn"),
    (False, "short", "dqn"),
)
"""Whether the policy sees the context; half of the combinations, balanced."""


@dataclass(frozen=True)
class Kind:
    """One world, and what can vary in it.

    Attributes:
        world: class in `mbtl.zoo.small.worlds`.
        nominal: features by name.
        axes: name -> lowest and highest value.
        pairs: of axes, for problems of two.
        triple: of three.
        bounds: returns at which performance is 0 and 1.
        scale: usual sizes of what is seen.
        steps: of a long and of a short training.
        discrete: whether its actions are, so that DQN learns it.
        recipe: hyper-parameters beside `_SHAPES`.
    """

    world: str
    nominal: Mapping[str, float]
    axes: Mapping[str, tuple[float, float]]
    pairs: tuple[tuple[str, str], ...]
    triple: tuple[str, str, str]
    bounds: tuple[float, float]
    scale: tuple[float, ...]
    steps: Mapping[Length, int]
    recipe: Mapping[str, Any] = field(default_factory=dict)
    discrete: bool = False


_SENSORS = {"noise": (0.0, 0.6), "delay": (0.0, 5.0)}
_TURN = {"turn": (-1.5, 1.5)}
"""A factor on what an action does; sixteen values, none of them zero."""

KINDS: Mapping[str, Kind] = {
    "cart": Kind(
        "Cart",
        {"gravity": 9.8, "masscart": 1.0, "masspole": 0.1, "length": 0.5, "force": 10.0,
         "timestep": 0.02},
        {"gravity": (2.0, 32.0), "masscart": (0.3, 4.8), "masspole": (0.05, 3.2),
         "length": (0.05, 3.2), "force": (1.0, 31.0), "timestep": (0.005, 0.065),
         **_SENSORS, **_TURN},
        (("length", "force"), ("timestep", "gravity"), ("masscart", "turn")),
        ("masscart", "length", "force"),
        (0.0, 200.0), (0.5, 0.5, 0.1, 0.5), {"long": 120_000, "short": 30_000},
        {"gamma": 0.98, "learning_rate": 1e-3}, discrete=True,
    ),
    "swing": Kind(
        "Swing",
        {"max_speed": 8.0, "timestep": 0.05, "gravity": 10.0, "mass": 1.0, "length": 1.0},
        {"max_speed": (1.0, 16.0), "timestep": (0.01, 0.16), "gravity": (1.0, 31.0),
         "mass": (0.2, 2.6), "length": (0.2, 2.0), **_SENSORS, **_TURN},
        (("length", "gravity"), ("mass", "timestep"), ("gravity", "turn")),
        ("mass", "length", "gravity"),
        (-1000.0, -100.0), (0.5, 0.5, 2.0), {"long": 200_000, "short": 50_000},
        {"gamma": 0.93, "learning_rate": 1e-3, "max_grad_norm": 5.0},
    ),
    "acrobat": Kind(
        "Acrobot",
        {"gravity": 9.8, "length": 1.0, "mass": 1.0, "moment": 1.0, "torque": 1.0,
         "timestep": 0.2},
        {"gravity": (2.0, 17.0), "length": (0.5, 1.4), "mass": (0.4, 1.9), "moment": (0.2, 2.3),
         "torque": (0.6, 3.6), "timestep": (0.05, 0.35), **_SENSORS, **_TURN},
        (("mass", "torque"), ("gravity", "timestep"), ("length", "turn")),
        ("mass", "torque", "gravity"),
        (-200.0, -50.0), (0.5, 0.5, 0.5, 0.5, 1.0, 2.0), {"long": 100_000, "short": 40_000},
        {"gamma": 0.98, "learning_rate": 1e-3}, discrete=True,
    ),
    "hill": Kind(
        "MountainCar",
        {"power": 0.0015, "gravity": 0.0025, "max_speed": 0.07, "goal": 0.45},
        {"power": (0.0002, 0.0032), "gravity": (0.001, 0.007), "max_speed": (0.03, 0.105),
         "goal": (0.0, 0.45), **_SENSORS, **_TURN},
        (("power", "gravity"), ("gravity", "goal"), ("power", "turn")),
        ("power", "gravity", "goal"),
        (-20.0, 130.0), (0.3, 2.0), {"long": 30_000, "short": 8_000},
        {"gamma": 0.99, "learning_rate": 1e-3, "log_std": 0.0},
    ),
}  # fmt: skip


@dataclass(frozen=True)
class SmallProblem:
    """contexts -> world and parameters (`mbtl.engine.world_trainer.Problem`).

    Attributes:
        kind: of `KINDS`.
        axes: the features that vary.
        visible: whether a policy sees their values, as -1 to 1.
    """

    kind: str
    axes: tuple[str, ...]
    visible: bool

    def __call__(self, contexts: Sequence[Context]) -> tuple[Any, Any]:
        """The world, and the parameters of `contexts` with one leading axis."""
        from mbtl.engine import worlds
        from mbtl.zoo.small import worlds as small

        kind = KINDS[self.kind]
        world = worlds.Solo(small.Disturbed(getattr(small, kind.world)(), kind.scale))
        constants, seen = [], []
        for context in contexts:
            values = {name: float(value) for name, value in context.items()}
            sensors = {name: values.pop(name, 0.0) for name in _SENSORS}
            constants.append({**_constants(self.kind, {**kind.nominal, **values}), **sensors})
            ranges = ((context[name], *kind.axes[name]) for name in self.axes)
            seen.append([2 * (float(x) - low) / (high - low) - 1 for x, low, high in ranges])
        shown = seen if self.visible and seen else None
        return world, worlds.stack_params(world, constants, shown)


def _constants(kind: str, features: Mapping[str, float]) -> Mapping[str, float]:
    """What a step of the world needs; `turn` is a factor on what an action does."""
    from mbtl.zoo.cmdps import cartpole, pendulum

    own = dict(features)
    turn = own.pop("turn", 1.0)
    if kind == "cart":
        return cartpole.derive({**own, "force": turn * own["force"]})._asdict()
    if kind == "swing":
        constants = pendulum.derive(own)._asdict()
        return {**constants, "torque_gain": turn * constants["torque_gain"]}
    name = {"acrobat": "torque", "hill": "power"}[kind]
    return {**own, name: turn * own[name]}


def problem(kind: str, axes: tuple[str, ...], visible: bool, length: Length, by: Algorithm) -> CMDP:
    """One of the small problems."""
    one = KINDS[kind]
    count = SOURCES if len(axes) == 1 else 4
    space = ContextSpace.grid({Linear(name, *one.axes[name]): count for name in axes})
    recipe = {**_SHAPES[by], **one.recipe}
    sight = "seen" if visible else "hidden"
    trainer = WorldTrainer(
        SmallProblem(kind, axes, visible),
        algorithm="DQN" if by == "dqn" else "PPO",
        timesteps=one.steps[length],
        hyperparameters=recipe,
        eval_episodes=20,
        checkpoint="best",
        checkpoint_every=one.steps[length] // 5,
        checkpoint_episodes=4,
    )
    return CMDP(f"{kind}-{'-'.join(axes)}-{sight}-{length}-{by}", space, trainer, bounds=one.bounds)


def groups() -> Iterator[tuple[int, list[CMDP]]]:
    """All small problems, those of one world, recipe and length together, each with its seed."""
    for name, (visible, length, by) in product(KINDS, _SETTINGS):
        if by == "dqn" and not KINDS[name].discrete:
            continue
        one: list[tuple[str, ...]] = [(axis,) for axis in KINDS[name].axes]
        two: list[tuple[str, ...]] = list(KINDS[name].pairs) if length == "long" else []
        three = [] if by == "dqn" else [KINDS[name].triple]  # it takes minutes each
        # what a policy sees decides about its network, so about what can be trained together
        for some in (one, two, three) if visible else (one + two, three):
            group = [problem(name, axes, visible, length, by) for axes in some]
            if group:
                yield zlib.crc32(group[0].id.encode()) % 1000, group
