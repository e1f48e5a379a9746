"""Rollouts with hand-made policies: no RL library."""

from functools import partial

import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit
from training_envs import Endless, Guess

from mbtl.envs import rollout
from mbtl.envs.references import Controller, played
from mbtl.envs.rollout import ROWS, Actor, Job, play
from mbtl.errors import InvalidInput, TrainingFailed
from mbtl.faults import reason_of
from mbtl.portfolio.mlp import DiscreteHead, MLPPolicy
from mbtl.score import Score


class SignPolicy:
    """Always right."""

    def predict(self, observation, deterministic=True):
        assert len(observation) == ROWS
        return (observation[:, 0] > 0).astype(int), None


class Counter:
    """Recurrent: counts its steps and is right from the third on, wrong before."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        count = np.zeros((1, len(observation), 1)) if state is None else state[0]
        count = np.where(episode_start[None, :, None], 0, count) + 1
        right = observation[:, 0] > 0
        return np.where(count[0, :, 0] >= 3, right, ~right).astype(int), (count,)


def jobs(make_env, lengths, seeds, score=None):
    return [Job(partial(make_env, {"length": n}), seeds, score) for n in lengths]


def test_a_dense_policy_alone_does_what_it_does_among_others():
    rng = np.random.default_rng(0)
    weights = (rng.standard_normal((16, 1)), rng.standard_normal((2, 16)))
    biases = (rng.standard_normal(16), rng.standard_normal(2))
    policy = MLPPolicy(
        tuple(w.astype(np.float32) for w in weights), tuple(b.astype(np.float32) for b in biases),
        "tanh", (1,), DiscreteHead((2,)),
    )  # fmt: skip
    lengths = [40 + i % 5 for i in range(40)]
    alone, together = (
        play(jobs(Guess, lengths, [0, 1]), Actor(policy), max_envs=n) for n in (1, 40)
    )
    assert [r.tolist() for r in alone] == [r.tolist() for r in together]
    assert 0 < np.mean([r.mean() / n for r, n in zip(alone, lengths, strict=True)]) < 1


@pytest.mark.parametrize("max_envs", [1, 40, 100])
def test_episodes_come_in_order_also_of_more_jobs_than_environments_or_rows(max_envs):
    lengths = [1 + i % 5 for i in range(70)]
    returns = play(jobs(Guess, lengths, [0, 1, 2]), Actor(SignPolicy()), max_envs=max_envs)
    assert [r.tolist() for r in returns] == [[n] * 3 for n in lengths]


def test_an_episode_whose_score_is_known_is_not_played_on():
    played = []

    class Known(Guess):
        def step(self, action):
            played.append(self.left)
            seen, reward, terminated, truncated, info = super().step(action)
            info = {"score": -1.0} if terminated else {}
            if self.left <= self.length - 3:
                info["final_score"] = -100.0
            return seen, reward, terminated, truncated, info

    score = Score("score", foretold="final_score")
    returns = play(jobs(Known, [2, 50], [0, 1], score), Actor(SignPolicy()), max_envs=1)
    assert [r.tolist() for r in returns] == [[-1.0, -1.0], [-100.0, -100.0]]
    assert played == [2, 1, 2, 1, 50, 49, 48, 50, 49, 48]


@pytest.mark.parametrize("wrap", [np.array, lambda seen: {f"x{len(seen)}": np.array(seen)}])
def test_observations_of_several_shapes_are_told_with_their_contexts(wrap):
    class Wide(Guess):
        def _next(self):
            return wrap([0.0] * self.length)

    some = [Job(partial(Wide, c), [0], context=c) for c in ({"length": 2}, {"length": 3})]
    with pytest.raises(
        InvalidInput, match=r"\(2,\).* in {'length': 2} and .*\(3,\).* `mbtl check`"
    ):
        play(some, Actor(SignPolicy()), max_envs=2)


class Team:
    agents = possible_agents = ("a", "b")

    def reset(self, seed=None):
        self.steps, self.agents = 0, ["a", "b"]
        return dict.fromkeys(self.agents, np.zeros(1, np.float32)), {}

    def step(self, actions):
        self.steps += 1
        info = {"final_score": -7.0} if self.steps == 3 else {}
        seen = dict.fromkeys(self.agents, np.zeros(1, np.float32))
        never = dict.fromkeys(self.agents, False)
        return seen, dict.fromkeys(self.agents, 1.0), never, never, {"a": info, "b": info}

    def close(self):
        pass


def test_a_team_whose_score_is_known_is_not_played_on():
    score = Score("score", foretold="final_score")
    (scores,) = play([Job(Team, [0, 1], score)], Actor(SignPolicy()), max_envs=1)
    assert scores.tolist() == [-7.0, -7.0]


def test_an_episode_of_several_strata_is_worth_their_mean_by_their_shares():
    class Lucky(Guess):
        """Worth 100 with one kind of luck, and its length with the other."""

        strata = (0.25, 0.75)

        def reset(self, seed=None, options=None):
            self.stratum = options["stratum"]
            return super().reset(seed=seed)

        def step(self, action):
            seen, reward, terminated, truncated, info = super().step(action)
            self.total = reward + (0.0 if self.left == self.length - 1 else self.total)
            info = {"worth": 100.0 if self.stratum == 0 else self.total}
            return seen, reward, terminated, truncated, info

    score = Score("worth", strata="strata")
    wrapped = [
        Job(lambda n=n: TimeLimit(Lucky({"length": n}), 1000), [0, 1, 2], score) for n in (4, 8)
    ]
    returns = play(wrapped, Actor(SignPolicy()), max_envs=1)
    assert [r.tolist() for r in returns] == [[25 + 3] * 3, [25 + 6] * 3]


def test_at_most_max_envs_are_alive_and_all_are_closed():
    alive, most = set(), []

    class Tracked(Guess):
        def __init__(self, context):
            super().__init__(context)
            alive.add(self)
            most.append(len(alive))

        def close(self):
            super().close()
            alive.remove(self)

    play(jobs(Tracked, [2, 9, 4, 1, 6], [0]), Actor(SignPolicy()), max_envs=2)
    assert (alive, max(most), len(most)) == (set(), 2, 5)
    play([Job(partial(Tracked, {}), [0])], Actor(SignPolicy()), max_envs=1, keep_open=True)
    assert len(alive) == 1


def test_environments_are_closed_after_an_error_that_names_the_context():
    made = []

    class Fails(Guess):
        def __init__(self, context):
            super().__init__(context)
            made.append(self)

        def step(self, action):
            raise RuntimeError("lost")

    with pytest.raises(RuntimeError, match="lost"):
        play(jobs(Fails, [2, 3], [0]), Actor(SignPolicy()), max_envs=5)
    assert [env.closed for env in made] == [True, True]

    some, each = [{"length": 2}, {"length": 3}], [[0], [1]]
    for make in (Fails, lambda context: 1 / 0):  # a step, and the factory itself
        with pytest.raises((RuntimeError, ZeroDivisionError)) as crash:
            played(make, Actor(SignPolicy()), some, each, score=None, max_envs=1)
        assert reason_of(crash.value).endswith(", in the context {'length': 2}")


def test_the_noise_of_actions_is_not_that_of_the_environment():
    """A policy that draws as the environment does would know every number before it is shown."""
    env, noise = Guess({"length": 9}), []

    class Draws:
        def predict(self, observation, deterministic=True, rng=None):
            noise.append(float(rng.uniform(-1, 1)))
            return np.zeros(len(observation), int), None

    play([Job(lambda: env, [5])], Actor(Draws(), sampled=True), max_envs=1)
    shown = [float(Guess.reset(env, seed=5)[0][0])]
    shown += [float(env.step(0)[0][0]) for _ in range(9)]
    assert not np.intersect1d(np.float32(noise), np.float32(shown)).size


def test_recurrent_state_follows_its_episode():
    lengths = [1, 2, 3, 8, 5] * 9
    returns = play(jobs(Guess, lengths, [0, 1, 2]), Actor(Counter()), max_envs=40)
    assert [r.tolist() for r in returns] == [[max(n - 2, 0)] * 3 for n in lengths]


def test_an_episode_without_end_is_an_error(monkeypatch):
    monkeypatch.setattr(rollout, "LONGEST_EPISODE", 50)
    with pytest.raises(TrainingFailed, match="TimeLimit"):
        play(jobs(Endless, [3], [0]), Actor(SignPolicy()), max_envs=1)


class Named(Guess):
    """Says things that mean nothing to whoever did not name them."""

    strata = (0.5, 0.5)
    worth = 0.25

    def step(self, action):
        *moved, info = super().step(action)
        told = {"score": 1e6, "final_score": "won", "worth": self.worth}
        return *moved, info | told


@pytest.mark.parametrize("nested", [False, True])
def test_an_episode_in_which_nan_was_seen_counts_as_not_played(nested):
    class Blind(Guess):
        """From its second step on."""

        def reset(self, **how):
            seen, info = super().reset(**how)
            return ({"x": (seen,)} if nested else seen), info

        def step(self, action):
            seen, *rest = super().step(action)
            return ({"x": (seen * np.nan,)} if nested else seen * np.nan, *rest)

    actor = Actor(Controller(lambda seen: 0))
    found = play(jobs(Blind, [1, 3], [0, 1]), actor, max_envs=2)
    assert np.isnan(found).all()


def test_words_among_observations_are_not_looked_at():
    class Told(Guess):
        def reset(self, **how):
            seen, info = super().reset(**how)
            return {"said": "go", "x": seen}, info

        def step(self, action):
            seen, *rest = super().step(action)
            return {"said": "on", "x": seen}, *rest

    actor = Actor(Controller(lambda seen: 0))
    assert np.isfinite(play(jobs(Told, [1, 3], [0, 1]), actor, max_envs=2)).all()


def test_a_team_of_which_one_saw_nan_has_not_played_also_where_it_leaves():
    class Blind(Team):
        def step(self, actions):
            seen, *rest = super().step(actions)
            self.agents = ["b"]
            return {**seen, "a": seen["a"] * np.nan}, *rest

    (found,) = play([Job(Blind, [1])], Actor(SignPolicy()), max_envs=1)
    assert np.isnan(found).all()


def test_nothing_counts_by_its_name_alone():
    (sums,) = play(jobs(Named, [4], [0, 1]), Actor(SignPolicy()), max_envs=1)
    assert sums.tolist() == [4.0, 4.0]
    (worth,) = play(jobs(Named, [4], [0, 1], Score("worth")), Actor(SignPolicy()), max_envs=1)
    assert worth.tolist() == [0.25, 0.25]


@pytest.mark.parametrize(
    ("key", "said"),
    [("delay", "must hold the score 'delay', got the keys"), ("final_score", "'won'")],
)
def test_a_named_score_must_be_there_and_a_number(key, said):
    with pytest.raises(TrainingFailed, match=said):
        play(jobs(Named, [4], [0], Score(key)), Actor(SignPolicy()), max_envs=1)


def test_a_factory_of_one_instance_is_refused_where_two_are_played_at_once():
    only = Guess({})
    with pytest.raises(InvalidInput, match="same instance twice"):
        play([Job(lambda: only, [0])] * 2, Actor(SignPolicy()), max_envs=2)


def test_what_a_closing_makes_of_an_interrupt_does_not_hide_it():
    class Interrupted(Guess):
        def step(self, action):
            raise KeyboardInterrupt

        def close(self):
            raise KeyError(81)  # as TraCI does when it reads the rest of an earlier answer

    with pytest.raises(KeyboardInterrupt):
        play(jobs(Interrupted, [4], [0]), Actor(SignPolicy()), max_envs=1)
