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
from training_envs import (
    Broken,
    Dies,
    Guess,
    GuessBits,
    GuessDict,
    GuessPair,
    MaskedGuess,
    NanAfter,
    NanReward,
    cartpole,
    pendulum,
)

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
from mbtl.seeds import Purpose, episode_seeds, evaluation_seeds
from mbtl.study.job import rehearse
from mbtl.trainers import SB3Trainer, Trainer, load_sb3

SHORT = {"n_steps": 64, "batch_size": 32, "n_epochs": 2}
POLE = {"length": 0.5}
POLES = [{"length": 0.1 * (i + 1)} for i in range(5)]


def ppo(make_env=cartpole, timesteps=256, **changes):
    settings = {"hyperparameters": SHORT, "eval_episodes": 2, **changes}
    return SB3Trainer(make_env, timesteps=timesteps, **settings)


def weights(model):
    return {name: value.numpy().copy() for name, value in model.policy.state_dict().items()}


def same(one, other):
    return (
        all(np.array_equal(one[name], other[name]) for name in one) and one.keys() == other.keys()
    )


@pytest.fixture(scope="module")
def trained():
    return ppo().train([POLE], 0).policy


# ---- training ------------------------------------------------------------------------------------


def test_exploration_does_not_draw_the_numbers_of_the_environment():
    shown, chosen = [], []

    class Coins(Guess):
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
    trainer = ppo(Guess, timesteps=3000, hyperparameters={**SHORT, "learning_rate": 0.003})
    returns = trainer.evaluate(trainer.train([{"length": 20}], 0).policy, [{"length": 20}], [1])
    assert returns.mean() >= 18  # always right: 20, blind guessing: 10


def test_same_seed_same_weights_other_seed_other_weights(trained):
    assert same(weights(ppo().train([POLE], 0).policy), weights(trained))
    assert not same(weights(ppo().train([POLE], 1).policy), weights(trained))


def test_training_reseeds_nothing_outside():
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
    assert draw() == expected
    assert torch.get_num_threads() == threads


def test_settings_are_not_changed_by_training():
    settings = {**SHORT, "policy_kwargs": {"net_arch": [8]}}
    ppo(hyperparameters=settings).train([POLE], 0)
    assert settings == {**SHORT, "policy_kwargs": {"net_arch": [8]}}


def test_spawned_process_trains_the_same_policy(trained):
    trainer = pickle.loads(pickle.dumps(ppo()))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        model = pool.submit(trainer.train, [POLE], 0).result().policy
    assert same(weights(model), weights(trained))


def test_progress_is_reported_to_the_end():
    reports = []
    ppo(timesteps=1000).train([POLE], 0, on_progress=reports.append)
    steps = [report.step for report in reports]
    assert 50 <= len(steps) <= 110
    assert steps == sorted(steps)
    assert (steps[-1], {report.total for report in reports}) == (1000, {1000})
    assert 5 < reports[-1].metrics["episode_return"] < 100


class Judged(gymnasium.Wrapper):
    """What an episode is worth is not the sum of its rewards."""

    def step(self, action):
        *outcome, info = self.env.step(action)
        return *outcome, info | ({"score": -7.0} if outcome[2] or outcome[3] else {})


def test_progress_tells_the_score_where_policies_are_judged_by_one():
    reports = []
    trainer = SB3Trainer(
        lambda c: Judged(cartpole(c)), timesteps=500, hyperparameters=SHORT, score="score"
    )
    trainer.train([POLE], 0, on_progress=reports.append)
    assert reports[-1].metrics == {"score": -7.0}


def test_policy_carries_no_environment_or_buffer():
    model = ppo(algorithm="DQN", hyperparameters={"learning_starts": 10}).train([POLE], 0).policy
    assert (model.env, model.replay_buffer) == (None, None)
    assert len(pickle.dumps(model)) < 1_000_000


def test_several_training_environments(trained):
    model = ppo(n_envs=3, hyperparameters={**SHORT, "n_steps": 32}).train([POLE], 0).policy
    assert not same(weights(model), weights(trained))


def test_training_environments_are_closed_also_after_an_error():
    made = []

    class Tracked(Broken):
        def __init__(self, context):
            super().__init__(context)
            made.append(self)

    with pytest.raises(RuntimeError, match="lost its connection"):
        ppo(Tracked, checkpoint="best", apart=False).train([{}], 0)
    assert [env.closed for env in made] == [True] * len(made)
    assert len(made) == 1 + 5


def test_contexts_of_one_physics_are_evaluated_in_episodes_of_their_own():
    """Else their luck is common, and never averages out in V."""

    class Draw(Guess):
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


def test_best_checkpoint_leaves_the_training_alone_and_gives_the_best_weights():
    plain, watched = [], []
    final = ppo(timesteps=1500).train([POLE], 2, on_progress=plain.append).policy
    chosen = ppo(timesteps=1500, checkpoint="best")
    best = chosen.train([POLE], 2, on_progress=watched.append).policy
    returns = [report.metrics["episode_return"] for report in plain if report.metrics]
    assert returns == [
        r.metrics["episode_return"] for r in watched if "episode_return" in r.metrics
    ]
    curve = [r.metrics["checkpoint_return"] for r in watched if "checkpoint_return" in r.metrics]
    assert watched[-1].metrics["best_return"] == max(curve)
    assert len(set(curve)) > 3
    assert same(weights(best), weights(final)) == (curve.index(max(curve)) == len(curve) - 1)


def test_best_checkpoint_returns_what_it_was_chosen_for():
    from mbtl.seeds import derive_seed

    reports = []
    best = (
        ppo(timesteps=1500, checkpoint="best", checkpoint_episodes=3)
        .train([POLE], 5, on_progress=reports.append)
        .policy
    )
    seeds = [derive_seed(5, Purpose.CHECKPOINT, episode) for episode in range(3)]
    jobs = [Job(lambda seed=seed: cartpole(POLE), [seed]) for seed in seeds]
    again = np.mean(play(jobs, Actor(best), max_envs=3))  # torch itself, not the numpy copy
    assert again == pytest.approx(reports[-1].metrics["best_return"])


def test_checkpoints_come_as_often_as_asked_and_not_for_unchanged_weights(monkeypatch):
    from mbtl.trainers import sb3_learning as watch

    visits = []
    real = watch.play
    monkeypatch.setattr(watch, "play", lambda *a, **k: visits.append(1) or real(*a, **k))
    ppo(timesteps=640, checkpoint="best", checkpoint_every=64).train([POLE], 0)
    assert len(visits) == 11  # before each of 10 updates, and the final weights
    visits.clear()
    ppo(timesteps=640, checkpoint="best", checkpoint_every=1).train([POLE], 0)
    assert len(visits) == 11


def test_few_checkpoint_environments_give_the_same_choice():
    many = ppo(timesteps=600, checkpoint="best")
    one, other = (each.train([POLE], 0).policy for each in (replace(many, n_eval_envs=1), many))
    assert same(weights(one), weights(other))


# ---- evaluation ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make_env", "algorithm", "contexts", "settings"),
    [
        (cartpole, "PPO", POLES, SHORT),
        (pendulum, "PPO", [{"mass": 0.5 + i} for i in range(5)], SHORT),
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


def test_no_targets_no_rows(trained):
    assert ppo().evaluate(trained, [], []).shape == (0, 2)


# ---- failures ------------------------------------------------------------------------------------


def test_nan_in_training_is_a_failed_training_with_its_reason():
    with pytest.raises(TrainingFailed, match="NaN by step"):
        ppo(NanAfter).train([{}], 0)


def test_weights_that_diverge_silently_are_noticed():
    with pytest.raises(TrainingFailed, match="finite weights"):
        ppo(NanReward, algorithm="DQN", hyperparameters={"learning_starts": 10}).train([{}], 0)


def test_nan_return_is_a_failed_evaluation():
    model = ppo(Guess, timesteps=64).train([{}], 0).policy
    with pytest.raises(TrainingFailed, match="finite and within"):
        ppo(NanReward).evaluate(model, [{}], [0])


def test_errors_of_the_environment_pass_through():
    with pytest.raises(RuntimeError, match="lost its connection"):
        ppo(Broken).train([{}], 0)


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
    given = {"learning_rate": "lin_2e-3", "replay_buffer_class": buffer}
    trainer = SB3Trainer(
        cartpole, timesteps=200, algorithm="DQN", hyperparameters={**given, "learning_starts": 50}
    )
    model = trainer.train([POLE], 0).policy
    assert model.replay_buffer_class.__name__ == "NStepReplayBuffer"
    assert [model.lr_schedule(left) for left in (1.0, 0.25, 0.0)] == [2e-3, 5e-4, 0.0]
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
        ("SAC", pendulum, "MlpPolicy", {"learning_starts": 150, "buffer_size": 1000}),
        ("ARS", cartpole, "LinearPolicy", {"n_delta": 2}),
        ("RecurrentPPO", cartpole, "MlpLstmPolicy", SHORT),
        ("MaskablePPO", MaskedGuess, "MlpPolicy", SHORT),
        ("PPO", GuessPair, "MlpPolicy", SHORT),
        ("PPO", GuessBits, "MlpPolicy", SHORT),
        ("PPO", GuessDict, "MultiInputPolicy", SHORT),
    ],
)
def test_algorithms_train_evaluate_save_and_load(algorithm, make_env, policy, settings, tmp_path):
    context = {"length": 0.5, "mass": 1.0} if make_env in (cartpole, pendulum) else {"length": 5}
    trainer = ppo(
        make_env, timesteps=200, algorithm=algorithm, policy=policy, hyperparameters=settings,
        checkpoint="best", checkpoint_every=100, checkpoint_episodes=2,
    )  # fmt: skip
    model = trainer.train([context], 0).policy
    returns = trainer.evaluate(model, [context], [1])
    assert returns.shape == (1, 2)
    assert trainer.save(model, tmp_path)
    assert np.array_equal(trainer.evaluate(trainer.load(tmp_path), [context], [1]), returns)
    if algorithm == "MaskablePPO":
        assert returns.tolist() == [[5.0, 5.0]]  # the mask allows nothing but the right answer


def test_a_class_may_be_given_instead_of_a_name():
    from stable_baselines3 import PPO

    assert isinstance(ppo(algorithm=PPO, timesteps=64).train([POLE], 0).policy, PPO)


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


def test_loading_reseeds_nothing(trained, tmp_path):
    import torch

    ppo().save(trained, tmp_path)
    state = torch.get_rng_state()
    load_sb3(tmp_path)
    assert torch.equal(torch.get_rng_state(), state)


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
        "for name in ('torch', 'stable_baselines3', 'gymnasium'):\n"
        "    sys.modules[name] = None\n"
        "from mbtl.portfolio import load_portfolio\n"
        f"policy = load_portfolio({str(folder)!r}).policy_for({{'length': 0.3}})\n"
        "print(int(policy.predict(numpy.full(4, 0.1))[0]))\n"
    )
    out = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert int(out.stdout) == int(trained.predict(np.full(4, 0.1), deterministic=True)[0])


def test_portfolio_without_a_numpy_copy_reads_the_zip_or_names_the_extra(tmp_path, monkeypatch):
    from mbtl.portfolio.archive import load_policy

    trainer = ppo(GuessBits, timesteps=64)
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


def test_the_end_of_a_simulators_process_is_a_failed_training():
    trainer = SB3Trainer(
        Dies, timesteps=64, processes=True, hyperparameters={"n_steps": 64, "batch_size": 64}
    )
    with pytest.raises(SimulationFailed, match="end of a process"):
        trainer.train([{}], seed=0)


def test_an_untrained_policy_shows_that_evaluation_works_and_leaves_the_training_alone(trained):
    trainer = ppo()
    assert rehearse(trainer, POLES[:2], [5, 6]) is None
    assert same(weights(trainer.train([POLE], 0).policy), weights(trained))
    trouble = rehearse(ppo(hyperparameters={"learning_rat": 1.0}), POLES[:2], [5, 6])
    assert isinstance(trouble.error, InvalidInput)
