"""What learners, recipes and the trainer of worlds refuse, each in one sentence."""

from dataclasses import replace

import numpy as np
import pytest
from poles import params_of

import mbtl.engine.learners as engine
from mbtl.engine import worlds
from mbtl.engine.learners import blocks
from mbtl.engine.learners.recipes import EpisodicPPORecipe
from mbtl.errors import InvalidInput, TrainingFailed, UnknownName
from mbtl.problems import get_cmdp
from mbtl.zoo.worlds import CartPole, Pendulum

PPO, DQN = engine.PPORecipe(n_envs=2, n_steps=32, batch_size=32), engine.DQNRecipe
CARTPOLE, PENDULUM = worlds.Solo(CartPole()), worlds.Solo(Pendulum())
SWINGING = worlds.stack_params(PENDULUM, [dict.fromkeys(PENDULUM.params._fields[:-1], 1.0)])
ONE = params_of(CARTPOLE, [0.5])


class Idle(CartPole):
    """Somebody wrote it as of a box."""

    idle = (0,)


LOST = {"log_std": np.array([[0.0], [np.nan]])}


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: engine.recipe_named("SARSA", "sb3"), UnknownName, "Known: A2C, DQN, PPO"),
        (lambda: engine.recipe_named("PPO", "fats"), UnknownName, "'fast'"),
        (lambda: engine.A2CRecipe(n_steps=0), InvalidInput, "n_steps must be >= 1, got 0"),
        (lambda: replace(PPO, batch_size=48), InvalidInput, "batch_size must divide"),
        (lambda: DQN(n_envs=64, buffer_size=600), InvalidInput, "n_envs x train_freq = 256, got"),
        (lambda: DQN(target_every=0), InvalidInput, "target_every must be >= 1, got 0"),
        (lambda: DQN(n_envs=3), InvalidInput, "= 12, got 100000; the next is 100008"),
        (lambda: DQN(n_envs=4.0), InvalidInput, "n_envs must be a whole number, got 4.0"),
        (lambda: DQN(learning_starts=-1), InvalidInput, "learning_starts must be >= 0, got -1"),
        (lambda: DQN(learning_rate="1e-3"), InvalidInput, "learning_rate must be a number >= 0"),
        (lambda: replace(PPO, learning_rate=-1.0), InvalidInput, "number >= 0, got -1"),
        (lambda: replace(PPO, gamma=float("nan")), InvalidInput, "gamma must be a number >= 0"),
        (lambda: replace(PPO, gamma=2), InvalidInput, "gamma must be a .* >= 0 and <= 1, got 2"),
        (lambda: replace(PPO, hidden=(0, 64)), InvalidInput, "hidden must be >= 1, got 0"),
        (lambda: replace(PPO, hidden=None), InvalidInput, "hidden must be a whole number"),
        (lambda: worlds.Solo(Idle()), InvalidInput, "idle of Idle is an action, a whole"),
        (lambda: EpisodicPPORecipe(rows=100, minibatches=40), InvalidInput, "rows = 100"),
        (lambda: engine.MultiTaskRecipe(method="pako"), UnknownName, "'paco'"),
        (lambda: engine.MultiTaskRecipe(method="moore", n_parts=0), InvalidInput, "n_parts must"),
        (lambda: engine.start(PENDULUM, DQN(), [0], SWINGING), InvalidInput, "discrete actions"),
        (lambda: engine.train(CARTPOLE, PPO, [0, 1], ONE, 9), InvalidInput, "one seed per context"),
        (lambda: engine.train(CARTPOLE, PPO, [0], ONE, 0), InvalidInput, "timesteps must be >= 1"),
        (lambda: blocks.check_finite(LOST, 64), TrainingFailed, "step 64 in policies 1 .1 in all"),
    ],
)
def test_recipes_and_learners_refuse(call, error, words):
    with pytest.raises(error, match=words):
        call()


def test_layers_may_come_as_json_has_them():
    assert replace(PPO, hidden=[8, 4]) == replace(PPO, hidden=(8, 4))
    assert replace(PPO, hidden=np.array([8, 4])).hidden == (8, 4)


@pytest.mark.parametrize(
    ("id", "preset", "options", "error", "words"),
    [
        ("cartpole-length", "quick", {"algorithm": "SAC"}, UnknownName, "SAC"),
        ("cartpole-length", "quick", {"hyperparameters": {"rate": 1}}, UnknownName, "rate"),
        ("cartpole-length", "quick", {"recipe_name": "slow"}, UnknownName, "slow"),
        ("cartpole-length", "quick", {"timesteps": 0}, InvalidInput, "timesteps"),
        ("cartpole-length", "quick", {"checkpoint": "worst"}, InvalidInput, "checkpoint"),
        ("ring-acc", "quick", {"algorithm": "DQN"}, InvalidInput, "discrete"),
        ("ring-acc", "quick", {"reward": "delay"}, UnknownName, "reward of this world"),
        ("ring-acc", "quick", {"hyperparameters": {"begin": "x"}}, InvalidInput, "RingTwin"),
        ("eco-green", "standard", {"actions": "jerk"}, UnknownName, "actions of this world"),
        ("eco-green", "standard", {"reward": "speed"}, UnknownName, "delay, paper, platoon, road"),
        ("eco-green", "standard", {"hyperparameters": {"begin": "glyde"}}, UnknownName, "glide"),
        ("eco-green", "paper", {"hyperparameters": {"begin": "glide"}}, InvalidInput, "actions='s"),
        ("eco-green", "standard", {"hyperparameters": {"hidden": (8,)}}, InvalidInput, "layers"),
    ],
)
def test_the_trainer_of_a_world_refuses(id, preset, options, error, words):
    cmdp = get_cmdp(id, engine="jax")
    with pytest.raises(error, match=words):
        cmdp.trainer_for(preset, **options).train([cmdp.space.context(9)], 0)
