"""One policy for all contexts by an ordinary trainer."""

import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

from test_everywhere import CONTEXTS, Told

from mbtl.trainers import SB3Trainer


@pytest.mark.long
def test_one_policy_serves_all_contexts_that_it_is_told():
    trainer = SB3Trainer(
        Told, algorithm="PPO", timesteps=6_000, eval_episodes=1,
        hyperparameters={"n_steps": 200, "batch_size": 50, "learning_rate": 3e-3, "gamma": 0.0,
                         "n_epochs": 4, "ent_coef": 0.1},  # eight of eight seeds find 0
    )  # fmt: skip
    policy = trainer.train(CONTEXTS, seed=0).policy
    returns = trainer.evaluate(policy, CONTEXTS, range(len(CONTEXTS)))
    assert returns.mean() > -0.8  # untold: -1 at best
