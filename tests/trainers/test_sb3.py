"""The Stable-Baselines3 trainer on real, short trainings."""

import json
import multiprocessing
import pickle
import random
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import training_envs as envs
from training_envs import cartpole, pendulum, same

from mbtl.envs.rollout import Actor, Job, play
from mbtl.errors import (
    InvalidInput,
    MissingExtra,
    SimulationFailed,
    StorageError,
    TrainingFailed,
    UnknownName,
)
from mbtl.portfolio import MLPPolicy
from mbtl.seeds import Purpose, derive_seed, episode_seeds, evaluation_seeds
from mbtl.study.job import rehearse
from mbtl.trainers import SB3Trainer, Trainer, load_sb3
from mbtl.trainers.algorithms import algorithm_class

SHORT = {"n_steps": 64, "batch_size": 32, "n_epochs": 2}
POLE = {"length": 0.5}
POLES = [{"length": 0.1 * (i + 1)} for i in range(5)]


def ppo(make_env=cartpole, timesteps=256, **changes):
    settings = {"hyperparameters": SHORT, "eval_episodes": 2, **changes}
    return SB3Trainer(make_env, timesteps=timesteps, **settings)


@pytest.fixture(scope="module")
def trained():
    return ppo().train([POLE], 0).policy


# ---- training ------------------------------------------------------------------------------------


def test_exploration_does_not_draw_the_numbers_of_the_environment():
    shown, chosen = [], []

    class Coins(envs.Guess):
        def _next(self):
            shown.append(int(self.np_random.integers(2)))
            return np.zeros(1, np.float32)

        def step(self, action):
            chosen.append(int(action))
            self.left -= 1
            return self._next(), 0.0, False, self.left == 0, {}

    settings = {"learning_starts": 100, "buffer_size": 100}  # nothing but exploration
    trainer = SB3Trainer(Coins, timesteps=40, algorithm="DQN", hyperparameters=settings)
    trainer.train([{"length": 100}], seed=3)
    assert 5 < (np.array(shown[:-1]) == chosen).sum() < 35


def test_training_learns():
    trainer = ppo(envs.Guess, timesteps=1536, hyperparameters={**SHORT, "learning_rate": 0.01})
    returns = trainer.evaluate(trainer.train([{"length": 20}], 0).policy, [{"length": 20}], [1])
    assert returns.mean() >= 18  # always right: 20, blind guessing: 10


def test_same_seed_same_weights_other_seed_other_weights(trained):
    assert same(pickle.loads(pickle.dumps(ppo())).train([POLE], 0).policy, trained)
    assert not same(ppo().train([POLE], 1).policy, trained)


def test_training_evaluating_and_loading_reseed_nothing_outside(tmp_path):
    import torch

    def draw():
        return random.random(), np.random.random(), float(torch.rand(1))  # noqa: NPY002

    def reseed():
        random.seed(7), np.random.seed(7), torch.manual_seed(7)  # noqa: NPY002

    threads = torch.get_num_threads()
    reseed()
    expected = draw()
    reseed()
    trainer = ppo()
    model = trainer.train([POLE], 0).policy
    trainer.evaluate(model, POLES[:1], [0])
    trainer.save(model, tmp_path)
    load_sb3(tmp_path)
    assert draw() == expected
    assert torch.get_num_threads() == threads


@pytest.mark.long  # it loads torch anew
def test_spawned_process_trains_the_same_policy(trained):
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        model = pool.submit(ppo().train, [POLE], 0).result().policy
    assert same(model, trained)


def test_progress_is_reported_to_the_end():
    reports = []
    ppo(timesteps=512).train([POLE], 0, on_progress=reports.append)
    steps = [report.step for report in reports]
    assert 50 <= len(steps) <= 110
    assert steps == sorted(steps)
    assert (steps[-1], {report.total for report in reports}) == (512, {512})
    assert 5 < reports[-1].metrics["episode_return"] < 100


class Judged(gymnasium.Wrapper):
    """What an episode is worth is not the sum of its rewards."""

    def step(self, action):
        *outcome, info = self.env.step(action)
        return *outcome, info | ({"score": -7.0} if outcome[2] or outcome[3] else {})


def test_progress_tells_the_score_where_policies_are_judged_by_one():
    reports = []
    trainer = SB3Trainer(
        lambda c: Judged(cartpole(c)), timesteps=256, hyperparameters=SHORT, score="score"
    )
    trainer.train([POLE], 0, on_progress=reports.append)
    assert reports[-1].metrics == {"score": -7.0}


def test_training_environments_are_closed_also_after_an_error():
    made = []

    class Tracked(envs.Broken):
        def __init__(self, context):
            super().__init__(context)
            made.append(self)

    with pytest.raises(RuntimeError, match="lost its connection"):
        ppo(Tracked, checkpoint="best", apart=False).train([{}], 0)
    assert [env.closed for env in made] == [True] * len(made)
    assert len(made) == 1 + 5


def test_contexts_of_one_physics_are_evaluated_in_episodes_of_their_own():
    """Else their luck is common, and never averages out in V."""

    class Draw(envs.Guess):
        def points(self, action):
            return self.number[0]

    def by_hand(seed):
        env = Draw(POLE)
        env.reset(seed=seed)
        return sum(env.step(0)[1] for _ in range(5))

    seeds = evaluation_seeds(0, 0, range(3))
    trainer = ppo(Draw, timesteps=64)
    one, other = (
        trainer.evaluate(trainer.train([POLE], seed).policy, [{}, {}, {}], seeds) for seed in (0, 1)
    )
    expected = [[by_hand(seed) for seed in own] for own in episode_seeds(seeds, 3, 2)]
    assert one == pytest.approx(np.array(expected))
    assert len(np.unique(one)) == one.size
    assert np.array_equal(one, other)  # the same for every policy


# ---- best checkpoint -----------------------------------------------------------------------------


def test_best_checkpoint_leaves_the_training_alone_and_gives_what_it_was_chosen_for():
    plain, watched = [], []
    final = ppo(timesteps=1024).train([POLE], 2, on_progress=plain.append).policy
    chosen = ppo(timesteps=1024, checkpoint="best", checkpoint_every=128, checkpoint_episodes=3)
    best = chosen.train([POLE], 2, on_progress=watched.append).policy
    told, seen = (
        [r.metrics["episode_return"] for r in some if "episode_return" in r.metrics]
        for some in (plain, watched)
    )
    assert told == seen
    curve = [r.metrics["checkpoint_return"] for r in watched if "checkpoint_return" in r.metrics]
    assert watched[-1].metrics["best_return"] == max(curve)
    assert len(set(curve)) > 3
    assert same(best, final) == (curve.index(max(curve)) == len(curve) - 1)
    seeds = [derive_seed(2, Purpose.CHECKPOINT, episode) for episode in range(3)]
    jobs = [Job(lambda seed=seed: cartpole(POLE), [seed]) for seed in seeds]
    again = np.mean(play(jobs, Actor(best), max_envs=3))  # torch itself, not the numpy copy
    assert again == pytest.approx(max(curve))
    assert same(replace(chosen, n_eval_envs=1).train([POLE], 2).policy, best)


def test_unchanged_weights_are_not_evaluated_again(monkeypatch):
    from mbtl.trainers import sb3_learning as watch

    visits, real = [], watch.play
    monkeypatch.setattr(watch, "play", lambda *a, **k: visits.append(1) or real(*a, **k))
    trainer = ppo(timesteps=320, checkpoint="best", checkpoint_every=1, checkpoint_episodes=1)
    trainer.train([POLE], 0)
    assert len(visits) == 6  # before each of 5 updates, and the final weights


# ---- evaluation ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make_env", "algorithm", "contexts", "settings"),
    [
        (cartpole, "PPO", POLES, SHORT),
        (pendulum, "SAC", [{"mass": 0.5 + i} for i in range(5)], {"learning_starts": 40}),
    ],
)
def test_returns_do_not_depend_on_the_other_targets(make_env, algorithm, contexts, settings):
    trainer = ppo(make_env, timesteps=64, algorithm=algorithm, hyperparameters=settings)
    model = trainer.train([contexts[0]], 0).policy
    together = trainer.evaluate(model, contexts, range(5))
    assert together.shape == (5, 2)
    alone = [trainer.evaluate(model, [c], [seed]) for seed, c in enumerate(contexts)]
    assert np.array_equal(together, np.vstack(alone))
    assert np.array_equal(together[::-1], trainer.evaluate(model, contexts[::-1], range(5)[::-1]))
    few = ppo(make_env, n_eval_envs=2)
    assert np.array_equal(together, few.evaluate(model, contexts, range(5)))
    assert len(np.unique(together)) > 2


def test_torch_fallback_does_not_depend_on_the_other_targets_either():
    import torch

    masses = [{"mass": 0.5 + 0.2 * i} for i in range(40)]
    elu = {**SHORT, "policy_kwargs": {"activation_fn": torch.nn.ELU}}
    trainer = ppo(pendulum, timesteps=64, hyperparameters=elu, eval_episodes=1)
    model = trainer.train([masses[0]], 0).policy
    together = trainer.evaluate(model, masses, range(40))
    assert np.array_equal(together[37:], trainer.evaluate(model, masses[37:], range(37, 40)))


def test_numpy_copy_and_torch_give_the_same_returns(trained):
    trainer = ppo()
    pairs = zip(POLES, episode_seeds(range(5), 5, 2), strict=True)
    jobs = [Job(lambda c=c: cartpole(c), seeds) for c, seeds in pairs]
    assert np.array_equal(
        trainer.evaluate(trained, POLES, range(5)), play(jobs, Actor(trained), max_envs=9)
    )
    assert trainer.evaluate(trained, [], []).shape == (0, 2)


# ---- failures ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make_env", "algorithm", "error", "words"),
    [
        (envs.NanAfter, "PPO", TrainingFailed, "NaN by step"),
        (envs.NanReward, "DQN", TrainingFailed, "finite weights"),
        (envs.Broken, "PPO", RuntimeError, "lost its connection"),  # as it is
        (envs.Gone, "PPO", SimulationFailed, "end of a process"),
    ],
)
def test_a_training_that_breaks_says_why(make_env, algorithm, error, words):
    settings = SHORT if algorithm == "PPO" else {"learning_starts": 10}
    with pytest.raises(error, match=words):
        ppo(make_env, algorithm=algorithm, hyperparameters=settings).train([{}], 0)


def test_nan_return_is_a_failed_evaluation():
    model = ppo(envs.Guess, timesteps=64).train([{}], 0).policy
    with pytest.raises(TrainingFailed, match="got NaN in all of 2"):
        ppo(envs.NanReward).evaluate(model, [{}], [0])


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"algorithm": "PPOO"}, UnknownName, "Did you mean 'PPO'"),
        ({"algorithm": int}, InvalidInput, "subclass of Stable-Baselines3"),
        ({"timesteps": 0}, InvalidInput, "timesteps must be a whole number >= 1, got 0"),
        ({"eval_episodes": 2.5}, InvalidInput, "eval_episodes"),
        ({"n_eval_envs": 0}, InvalidInput, "n_eval_envs"),
        ({"checkpoint": "last"}, InvalidInput, "'final' or 'best'"),
        ({"make_env": "CartPole-v1"}, InvalidInput, "function of a context"),
    ],
)
def test_wrong_settings_are_refused_at_once(changes, error, message):
    with pytest.raises(error, match=message):
        ppo(**changes)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"learning_rat": 1.0}, "Did you mean 'learning_rate'"),
        ({"seed": 1}, "got 'seed'"),
        ({"learning_rate": "lin_fast"}, "'lin_1e-3', got 'lin_fast'"),
        ({"learning_rate": "lin_nan"}, "'lin_1e-3', got 'lin_nan'"),
        ({"rollout_buffer_class": "mbtl.trainers.shared:Nothing"}, "'module:name', got"),
        ({"rollout_buffer_class": "json"}, "'module:name', got 'json'"),
    ],
)
def test_wrong_hyperparameters_are_refused_before_training(settings, message):
    with pytest.raises(InvalidInput, match=message):
        ppo(hyperparameters=settings).train([POLE], 0)


def test_a_number_that_falls_and_a_class_are_given_by_name():
    buffer = "stable_baselines3.common.buffers:NStepReplayBuffer"
    kwargs = {"net_arch": [8]}  # which the library changes
    given = {
        "learning_rate": "lin_2e-3", "replay_buffer_class": buffer, "policy_kwargs": kwargs
    }  # fmt: skip
    trainer = SB3Trainer(
        cartpole, timesteps=200, algorithm="DQN", hyperparameters={**given, "learning_starts": 50}
    )
    model = trainer.train([POLE], 0).policy
    assert model.replay_buffer_class.__name__ == "NStepReplayBuffer"
    assert [model.lr_schedule(left) for left in (1.0, 0.25, 0.0)] == [2e-3, 5e-4, 0.0]
    assert kwargs == {"net_arch": [8]}
    assert trainer.recipe["hyperparameters"] == {**given, "learning_starts": 50}


def test_missing_library_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(MissingExtra, match=r"pip install 'mbtl\[train\]'"):
        ppo().train([POLE], 0)


# ---- other algorithms and spaces -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("algorithm", "make_env", "policy", "settings"),
    [
        ("TRPO", cartpole, "MlpPolicy", {"n_steps": 64, "batch_size": 32}),
        ("A2C", cartpole, "MlpPolicy", {}),
        ("DQN", cartpole, "MlpPolicy", {"learning_starts": 50, "buffer_size": 1000}),
        ("SAC", pendulum, "MlpPolicy", {"learning_starts": 100, "buffer_size": 1000}),
        ("ARS", cartpole, "LinearPolicy", {"n_delta": 2}),
        ("RecurrentPPO", cartpole, "MlpLstmPolicy", SHORT),
        ("MaskablePPO", envs.MaskedGuess, "MlpPolicy", SHORT),
        ("PPO", envs.GuessPair, "MlpPolicy", SHORT),
        ("PPO", envs.GuessBits, "MlpPolicy", SHORT),
        ("PPO", envs.GuessDict, "MultiInputPolicy", SHORT),
    ],
)
def test_algorithms_train_evaluate_save_and_load(algorithm, make_env, policy, settings, tmp_path):
    algorithm = algorithm_class(algorithm) if make_env is envs.GuessPair else algorithm
    context = {"length": 0.5, "mass": 1.0} if make_env in (cartpole, pendulum) else {"length": 5}
    trainer = ppo(
        make_env, timesteps=128, algorithm=algorithm, policy=policy, hyperparameters=settings,
        checkpoint="best", checkpoint_every=64, checkpoint_episodes=1,
    )  # fmt: skip
    model = trainer.train([context], 0).policy
    assert (model.env, getattr(model, "replay_buffer", None)) == (None, None)
    returns = trainer.evaluate(model, [context], [1])
    assert returns.shape == (1, 2)
    assert trainer.save(model, tmp_path)
    assert np.array_equal(trainer.evaluate(trainer.load(tmp_path), [context], [1]), returns)
    if algorithm == "MaskablePPO":
        assert returns.tolist() == [[5.0, 5.0]]  # the mask allows nothing but the right answer


# ---- files ---------------------------------------------------------------------------------------


def test_saved_policy_has_the_zip_and_a_numpy_copy(trained, tmp_path):
    trainer: Trainer = ppo()
    assert trainer.policy_format == "sb3"
    trainer.save(trained, tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["model.zip", "policy.json", "sb3.json", "weights.npz"]
    batch = np.random.default_rng(0).normal(size=(100, 4)).astype(np.float32)
    expected = trained.predict(batch, deterministic=True)[0]
    assert np.array_equal(MLPPolicy.load(tmp_path).predict(batch)[0], expected)
    assert np.array_equal(load_sb3(tmp_path).predict(batch, deterministic=True)[0], expected)


def test_foreign_or_damaged_folders_give_one_clear_error(trained, tmp_path):
    with pytest.raises(StorageError, match=r"sb3\.json"):
        load_sb3(tmp_path)
    ppo().save(trained, tmp_path)
    (tmp_path / "model.zip").write_bytes(b"not a zip")
    with pytest.raises(StorageError, match="written with"):
        load_sb3(tmp_path)
    record = json.loads((tmp_path / "sb3.json").read_text())
    (tmp_path / "sb3.json").write_text(json.dumps({**record, "package": "os"}))
    with pytest.raises(InvalidInput, match="algorithm=<the class>"):
        load_sb3(tmp_path)


def test_portfolio_of_trained_policies_works_without_torch(trained, tmp_path):
    from mbtl.contexts import ContextSpace, Linear
    from mbtl.objective import Bounds
    from mbtl.portfolio import Portfolio, load_portfolio

    trainer = ppo()
    (tmp_path / "source-0000").mkdir()
    trainer.save(trained, tmp_path / "source-0000")
    space = ContextSpace.grid({Linear("length", 0.1, 1.0, "m"): 3})
    returns = trainer.evaluate(trained, space.contexts, range(space.n)).mean(axis=1)[None, :]
    portfolio = Portfolio(
        space, (0,), returns, Bounds(0, 500),
        policy_folders=(tmp_path / "source-0000",), policy_format="sb3", load=trainer.load,
    )  # fmt: skip
    assert type(portfolio.policy(0)) is type(trained)
    folder = portfolio.save(tmp_path / "portfolio")
    assert isinstance(load_portfolio(folder).policy(0), MLPPolicy)
    assert type(load_portfolio(folder, load=load_sb3).policy(0)) is type(trained)
    script = (
        "import sys, numpy\n"
        "for name in ('torch', 'stable_baselines3', 'gymnasium', 'jax'):\n"
        "    sys.modules[name] = None\n"
        "from mbtl.portfolio import load_portfolio\n"
        f"policy = load_portfolio({str(folder)!r}).policy_for({{'length': 0.3}})\n"
        "print(int(policy.predict(numpy.full(4, 0.1))[0]))\n"
    )
    out = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert int(out.stdout) == int(trained.predict(np.full(4, 0.1), deterministic=True)[0])


def test_portfolio_without_a_numpy_copy_reads_the_zip_or_names_the_extra(tmp_path, monkeypatch):
    from mbtl.portfolio.archive import load_policy

    trainer = ppo(envs.GuessBits, timesteps=64)
    trainer.save(trainer.train([{}], 0).policy, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.zip", "sb3.json"]
    loaded = load_policy(tmp_path, "sb3", None, trust=True)
    assert loaded.predict(np.zeros(1))[0].shape == (2,)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(MissingExtra, match="train"):
        load_policy(tmp_path, "sb3", None, trust=True)


def test_describing_a_trainer_imports_no_rl_library():
    script = (
        "import sys\n"
        "from mbtl.trainers import SB3Trainer\n"
        "SB3Trainer(print, timesteps=10, algorithm='TRPO')\n"
        "assert not {'torch', 'stable_baselines3', 'gymnasium'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


@pytest.mark.long  # it loads torch anew
def test_the_end_of_a_simulators_process_is_a_failed_training():
    trainer = SB3Trainer(
        envs.Dies, timesteps=64, processes=True, hyperparameters={"n_steps": 64, "batch_size": 64}
    )
    with pytest.raises(SimulationFailed, match="end of a process"):
        trainer.train([{}], seed=0)


def test_an_untrained_policy_shows_that_evaluation_works_and_leaves_the_training_alone(trained):
    trainer = ppo()
    assert rehearse(trainer, POLES[:2], [5, 6]) is None
    assert same(trainer.train([POLE], 0).policy, trained)
    trouble = rehearse(ppo(hyperparameters={"learning_rat": 1.0}), POLES[:2], [5, 6])
    assert isinstance(trouble.error, InvalidInput)
