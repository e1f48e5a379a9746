"""A scripted team says what must arrive; then Stable-Baselines3 learns on it and on the ramp."""

from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete
from stable_baselines3 import A2C, PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import obs_as_tensor

from mbtl.envs.slots import Slots, is_blank
from mbtl.errors import InvalidInput, SimulationFailed, UnknownName
from mbtl.trainers import SB3Trainer
from mbtl.trainers.shared import SharedRolloutBuffer, SharedVecEnv, TeamRolloutBuffer

LIVES = {"a": (0, 2), "b": (0, 5), "c": (2, 3), "d": (3, 6)}
"""Decisions in which an agent acts, from and until; an episode has 6."""


def reward_of(car, t):
    return float(ord(car) - ord("a") + 1) * 10.0 ** -(t + 1)


class Script:
    """Agents come and go by `LIVES`; agent and time make up observations and rewards."""

    def __init__(self, lives=LIVES):
        self.lives, self.agents, self.episodes, self.taken = lives, [], 0, []

    def observation_space(self, agent):
        return Box(-1.0, 9.0, (2,), np.float32)

    def action_space(self, agent):
        return Discrete(7)

    def _seen(self, car):
        return np.array([ord(car) - ord("a"), self.time], dtype=np.float32)  # (0, 0) at first

    def _find(self):
        self.agents = [car for car, (first, end) in self.lives.items() if first <= self.time < end]

    def reset(self, seed=None):
        self.time, self.episodes = 0, self.episodes + 1
        self._find()
        return {car: self._seen(car) for car in self.agents}, {car: {} for car in self.agents}

    def step(self, actions):
        assert set(actions) == set(self.agents)
        self.taken.append(dict(actions))
        acting, rewards = self.agents, {car: reward_of(car, self.time) for car in self.agents}
        self.time += 1
        self._find()
        over = self.time == 6
        everyone = [*acting, *(car for car in self.agents if car not in acting)]
        gone = {car: car in acting and car not in self.agents for car in everyone}
        return (
            {car: self._seen(car) for car in everyone},
            {car: rewards.get(car, 0.0) for car in everyone},
            {car: gone[car] and not over for car in everyone},
            dict.fromkeys(everyone, over),
            dict.fromkeys(everyone, {"score": float(self.episodes)} if over else {}),
        )

    def close(self):
        self.agents = []


def run(env, steps, action=3):
    """(rewards by slot and step, all infos)."""
    env.reset()
    results = [env.step(np.full(env.num_envs, action)) for _ in range(steps)]
    return results


def test_an_agent_keeps_its_slot_until_it_leaves_and_the_slot_goes_to_the_next():
    slots = Slots(Script, 3)
    slots.reset()
    seats = [list(slots.present)]
    for _ in range(6):
        slots.step(np.zeros(3, dtype=int))
        seats.append(list(slots.present))
    assert seats == [
        ["a", "b", None],
        ["a", "b", None],
        ["c", "b", None],
        ["d", "b", None],
        ["d", "b", None],
        ["d", None, None],
        ["a", "b", None],  # the next simulation
    ]


def test_every_reward_of_every_agent_arrives_once():
    env = SharedVecEnv([Script], slots=3)
    results = run(env, 12)
    delivered = sum(rewards.sum() for _, rewards, _, _ in results)
    due = sum(reward_of(car, t) for car, (first, end) in LIVES.items() for t in range(first, end))
    assert delivered == pytest.approx(2 * due)
    returns = sorted(
        info["episode"]["r"] for *_, infos in results for info in infos if "episode" in info
    )
    lives = [sum(reward_of(car, t) for t in range(*life)) for car, life in LIVES.items()]
    assert returns == pytest.approx(sorted(2 * lives))
    assert [info["score"] for *_, infos in results for info in infos if "score" in info] == [1, 2]


def test_each_agent_gets_the_action_of_its_slot():
    slots = Slots(Script, 2)
    slots.reset()
    for _ in range(3):
        slots.step(np.array([4, 5]))
    assert slots.team.taken == [{"a": 4, "b": 5}, {"a": 4, "b": 5}, {"c": 4, "b": 5}]


def test_a_life_ends_with_what_the_agent_saw_and_why():
    env = SharedVecEnv([Script], slots=2)
    results = run(env, 6)
    _, _, dones, infos = results[1]  # a leaves, c takes its slot
    assert dones.tolist() == [True, False]
    assert infos[0]["terminal_observation"].tolist() == [0.0, 2.0]
    assert not infos[0]["TimeLimit.truncated"]
    assert results[1][0][0].tolist() == [2.0, 2.0]
    _, _, dones, infos = results[5]  # the end of time
    assert infos[0]["TimeLimit.truncated"]
    assert dones.all()


def test_a_free_slot_is_blank_and_done_and_earns_nothing():
    env = SharedVecEnv([Script], slots=3)
    first = env.reset()
    assert is_blank(first).tolist() == [False, False, True]  # though agent a sees (0, 0)
    assert first == pytest.approx(np.array([[0, 0], [1, 0], [0, 0]]), abs=1e-30)
    seen, rewards, dones, infos = env.step(np.zeros(3, dtype=int))
    assert is_blank(seen[2])
    assert (rewards[2], dones[2], infos[2]) == (0.0, True, {})


def learner(algorithm, env, **options):
    return algorithm("MlpPolicy", env, device="cpu", seed=0, **env.rollout_buffer, **options)


class Look(BaseCallback):
    """What is learnt from, and what a last look would be worth."""

    def __init__(self, last=None):
        super().__init__()
        self.last = last

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        self.buffer = self.model.rollout_buffer
        self.taken = len(self.buffer.observations)
        if self.last is not None:  # worth to the critic that the rollout was judged with
            values = self.model.policy.predict_values(obs_as_tensor(self.last, "cpu"))
            self.worth = float(values.detach()[0])

    def of(self, name):
        """(agent, time) -> rows, in order."""
        rows = {}
        for seen, x in zip(self.buffer.observations, getattr(self.buffer, name), strict=True):
            rows.setdefault(tuple(np.rint(seen).astype(int)), []).append(float(np.ravel(x)[0]))
        return rows


def test_advantages_are_those_of_lone_agents_and_free_slots_are_not_learnt_from():
    env, look = SharedVecEnv([Script], slots=3), Look()
    model = learner(PPO, env, n_steps=6, batch_size=9, n_epochs=1, gamma=0.5, gae_lambda=1.0)
    assert isinstance(model.rollout_buffer, SharedRolloutBuffer)
    model.learn(6, callback=look)
    assert look.taken == sum(end - first for first, end in LIVES.values())
    assert not is_blank(look.buffer.observations).any()
    returns = look.of("returns")
    assert returns[0, 0] == pytest.approx([reward_of("a", 0) + 0.5 * reward_of("a", 1)], abs=1e-6)
    assert returns[2, 2] == pytest.approx([reward_of("c", 2)], abs=1e-6)
    model.learn(6, callback=look, reset_num_timesteps=False)  # the buffer is whole again
    assert look.taken == 11


class OneReward(Script):
    """All have the same reward, and the end of time ends the task."""

    def step(self, actions):
        time = self.time
        seen, rewards, gone, over, infos = super().step(actions)
        ended = {car: gone[car] or over[car] for car in gone}
        shared = dict.fromkeys(rewards, 2.0**-time)
        return seen, shared, ended, dict.fromkeys(over, False), infos


def test_a_team_is_credited_with_what_it_earns_after_an_agent_has_left():
    gamma, lam, look = 0.5, 0.75, Look()
    env = SharedVecEnv([OneReward, OneReward], slots=3, credit="team")
    twice = {"n_steps": 12, "batch_size": 36, "n_epochs": 1}  # two simulations
    model = learner(PPO, env, gamma=gamma, gae_lambda=lam, **twice)
    assert isinstance(model.rollout_buffer, TeamRolloutBuffer)
    model.learn(12, callback=look)
    assert look.taken == 4 * sum(end - first for first, end in LIVES.values())
    values, returns, advantages = map(look.of, ("values", "returns", "advantages"))
    due, value = 0.0, 0.0  # after the end
    for time in reversed(range(6)):
        acting = [ord(car) - ord("a") for car, (first, end) in LIVES.items() if first <= time < end]
        due = 2.0**-time + gamma * ((1.0 - lam) * value + lam * due)
        value = np.mean([values[agent, time] for agent in acting])
        for agent in acting:
            assert returns[agent, time] == pytest.approx([due] * 4, abs=1e-5)
            own = np.array(values[agent, time])
            assert advantages[agent, time] == pytest.approx(due - own, abs=1e-5)


class CutOff(Script):
    """Time cuts a off; b and c leave with their last decision."""

    def __init__(self):
        super().__init__(dict.fromkeys("abc", (0, 6)))

    def step(self, actions):
        seen, rewards, gone, over, infos = super().step(actions)
        over = {car: over[car] and car == "a" for car in over}
        gone = {car: self.time == 6 and not over[car] for car in gone}
        return seen, dict.fromkeys(rewards, 2.0), gone, over, infos


@pytest.mark.parametrize(("credit", "others"), [("team", True), ("own", False)])
def test_what_follows_the_cut_is_worth_as_much_to_a_team_that_is_smaller_by_then(credit, others):
    look = Look(np.array([[0.0, 6.0]], np.float32))  # of agent a
    env = SharedVecEnv([CutOff], slots=3, credit=credit)
    learner(A2C, env, n_steps=6, gamma=0.5, gae_lambda=1.0).learn(6, callback=look)
    value = look.worth
    assert abs(value) > 1e-3
    returns = look.of("returns")
    assert returns[0, 5] == pytest.approx([2.0 + 0.5 * value], abs=1e-5)
    for agent in (1, 2):
        assert returns[agent, 5] == pytest.approx([2.0 + 0.5 * value * others], abs=1e-5)


def make_team(context):
    team = OneReward()
    team.most_agents, team.possible_agents = 3, list(LIVES)
    return team


def test_the_trainer_credits_the_team_where_it_is_told_to():
    options = {"timesteps": 36, "algorithm": "A2C", "hyperparameters": {"n_steps": 6}}
    own = SB3Trainer(make_team, **options)
    team = SB3Trainer(make_team, **options, credit="team")
    assert "credit" not in own.recipe  # as it was before there was another
    assert team.recipe["credit"] == "team"
    weights = [trainer.train([{}], seed=0).policy.policy.state_dict() for trainer in (own, team)]
    assert any((weights[0][name] != weights[1][name]).any() for name in weights[0])


@pytest.mark.parametrize(
    ("make_env", "algorithm", "got"),
    [
        (make_team, "DQN", "got such environment and DQN"),
        (lambda context: gymnasium.make("CartPole-v1"), "A2C", "got no such environment and A2C"),
    ],
)
def test_team_rewards_need_a_team_and_an_algorithm_that_can_credit_them(make_env, algorithm, got):
    trainer = SB3Trainer(make_env, timesteps=10, algorithm=algorithm, credit="team")
    with pytest.raises(InvalidInput, match=got):
        trainer.train([{}], seed=0)
    with pytest.raises(UnknownName, match="own, team"):
        SB3Trainer(make_env, timesteps=10, credit="others")


def test_more_agents_than_slots_and_teams_without_agents_are_errors():
    with pytest.raises(InvalidInput, match="2 agents and 1 slots"):
        SharedVecEnv([Script], slots=1).reset()
    with pytest.raises(InvalidInput, match="give slots"):
        SharedVecEnv([Script])
    with pytest.raises(InvalidInput, match="at least one"):
        SharedVecEnv([])
    with pytest.raises(UnknownName, match="own, team"):
        SharedVecEnv([Script], slots=3, credit="others")
    with pytest.raises(SimulationFailed, match="without any"):
        Slots(partial(Script, {}), 1).reset()


# ---- the ramp ----------------------------------------------------------------------------------


def test_a_shared_policy_learns_on_the_ramp():
    from mbtl.zoo.cmdps.traffic.ramp import RampAcc

    env = SharedVecEnv([partial(RampAcc, {"hold": 40.0})])
    assert env.num_envs == env.slots == RampAcc.most_agents
    look = Look()
    model = learner(PPO, env, n_steps=12, batch_size=env.num_envs, n_epochs=1)
    before = [p.detach().clone() for p in model.policy.parameters()]
    model.learn(12 * env.num_envs, callback=look)  # a simulation has 10 decisions at most
    env.close()
    assert 10 < look.taken < 12 * env.num_envs  # cars come and go
    assert (look.buffer.rewards > 0.0).any()
    assert any((p != q).any() for p, q in zip(before, model.policy.parameters(), strict=True))
