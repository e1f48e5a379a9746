"""Simulators in jax of others: their fields as axes, their episodes as ours."""

import re
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import blocks
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mbtl
from mbtl.engine import Box, Discrete, jax_problem
from mbtl.engine.traced import with_fields
from mbtl.errors import InvalidInput, TrainingFailed, UnknownName
from mbtl.problems import check_cmdp
from mbtl.seeds import episode_seeds
from mbtl.trainers import reference_rows

HORIZON = 20
FAST = {"hyperparameters": {"n_envs": 8, "n_steps": 20, "batch_size": 80, "n_epochs": 4}}


@jax.tree_util.register_dataclass
@dataclass
class Sail:
    """Of a boat that is pushed by the wind."""

    drag: float = 0.2
    wind: Any = field(default_factory=lambda: jnp.array([0.3, 0.0]))
    paint: float = 1.0
    crew: int = 1


class Boat:
    """Stay in the middle of a pond; waves are random, and beyond its shores the episode is over."""

    action = Box((-1.0, -1.0), (1.0, 1.0))
    horizon = HORIZON

    def reset(self, key, params):
        place = jax.random.uniform(key, (2,), minval=-1.0, maxval=1.0)
        return self.seen(place, jnp.zeros(2)), {"place": place, "speed": jnp.zeros(2)}

    def step(self, key, state, action, params):
        push = action * params.crew + params.wind + 0.01 * jax.random.normal(key, (2,))
        speed = (1.0 - params.drag) * state["speed"] + 0.2 * push
        place = state["place"] + 0.2 * speed
        far = jnp.linalg.norm(place)
        new = {"place": place, "speed": speed}
        return self.seen(place, speed), new, 3.0 - far, far > 3.0

    def seen(self, place, speed):
        return {"where": place.reshape(1, 2), "speed": speed}


AXES = mbtl.ContextSpace.grid(
    {mbtl.Linear("drag", 0.1, 0.9): 2, mbtl.Linear("wind[1]", -0.5, 0.5): 2}
)


def grid(*axes, n=2):
    return mbtl.ContextSpace.grid(dict.fromkeys(axes, n))


def boat(space=AXES, **settings):
    settings = {"timesteps": 1600, "trainer_options": FAST, **settings}
    return jax_problem("boat", Boat(), Sail(), space, **settings)


def direct_return(context, seed, policy):
    """By calling the simulator, one context and step at a time."""
    world, _ = boat().trainer.problem([context])
    noise = world.draws(np.array([seed]))[0]
    bits = noise.view(np.uint32)
    root = jax.random.fold_in(jax.random.PRNGKey(bits[0]), bits[1])
    sail = Sail(drag=context["drag"], wind=jnp.array([0.3, context["wind[1]"]]))
    obs, state = Boat().reset(jax.random.fold_in(root, 0), sail)
    total = 0.0
    for moment in range(1, HORIZON + 1):
        numbers = jnp.concatenate([obs["speed"], obs["where"].ravel()])  # jax sorts the names
        action = policy.predict(np.asarray(numbers))[0]
        key = jax.random.fold_in(root, moment)
        obs, state, reward, over = Boat().step(key, state, action, sail)
        total += float(reward)
        if over:
            break
    return total


def test_an_evaluation_is_the_simulator_itself_in_each_context():
    trainer = boat(trainer_options={**FAST, "eval_episodes": 2}).trainer
    policy = trainer.untrained(AXES.context(0))
    returns = trainer.evaluate_many([policy], AXES.contexts, range(4))[0]
    seeds = episode_seeds(range(4), 4, 2)
    for context, own, found in zip(AXES.contexts, seeds, returns, strict=True):
        wanted = [direct_return(context, seed, policy) for seed in own]
        np.testing.assert_allclose(found, wanted, rtol=1e-4)


def test_the_gymnasium_environment_plays_the_episodes_of_evaluations():
    problem, context = boat(), AXES.context(3)
    policy = problem.trainer.untrained(context)
    env, total = problem.make_env(context), 0.0
    ((first, *_),) = episode_seeds([5], 1, 10)
    obs, _ = env.reset(seed=int(first))
    for moment in range(1, HORIZON + 1):
        obs, reward, terminated, truncated, _ = env.step(policy.predict(obs)[0])
        total += reward
        assert (terminated, truncated) == (False, moment == HORIZON)
    assert total == pytest.approx(problem.trainer.evaluate(policy, [context], [5])[0, 0], rel=1e-5)


def test_check_finds_the_axis_that_changes_nothing():
    space = grid(mbtl.Linear("drag", 0.1, 0.9), mbtl.Linear("paint", 0.0, 1.0))
    report = check_cmdp(boat(space), steps=HORIZON)
    assert [check.name for check in report.failures] == ["axis 'paint' acts on the dynamics"]


def test_training_on_one_context_and_on_all_raises_the_return():
    problem = boat(timesteps=16_000, show_context=True)
    trainer, contexts = problem.trainer, AXES.contexts
    random = reference_rows(trainer, contexts, range(4))["random_actions"].mean(axis=1)
    one = trainer.train(contexts[:1], seed=0).policy
    every = trainer.train(contexts, seed=0).policy
    best = 3.0 * HORIZON
    assert trainer.evaluate(one, contexts[:1], [0]).mean() > (random[0] + best) / 2
    assert trainer.evaluate(every, contexts, range(4)).mean() > (random.mean() + best) / 2
    assert problem.make_env(contexts[3]).reset(seed=0)[0][-2:].tolist() == [1.0, 1.0]


def test_a_function_of_an_observation_plays_the_episodes_of_policies():
    trainer, contexts = boat().trainer, AXES.contexts[:2]
    policy = trainer.untrained(contexts[0])
    found = trainer.measure(lambda seen: policy.predict(seen)[0], contexts, range(2))["score"]
    np.testing.assert_allclose(found, trainer.evaluate(policy, contexts, range(2)), rtol=1e-4)


def test_a_study_of_it_runs():
    study = mbtl.create_study(boat(), budget=1)
    study.run()
    assert np.isfinite(study.value)


def test_fields_are_set_by_path_index_and_number():
    tree = {"opt": Sail(), "mass": jnp.ones((2, 3))}
    changed = with_fields(tree, {"opt.wind[-1]": 2.0, "mass[:,0]": 5.0, "opt.crew": 3})
    assert changed["opt"].wind.tolist() == pytest.approx([0.3, 2.0])
    assert changed["mass"].tolist() == [[5.0, 1.0, 1.0]] * 2
    assert changed["opt"].crew.dtype.kind == "i"
    assert with_fields(tree, {"mass": 2.0})["mass"].tolist() == [[2.0] * 3] * 2
    assert tree["mass"].tolist() == [[1.0] * 3] * 2


def test_a_world_of_one_agent_can_be_looked_into_without_an_environment():
    alone = replace(boat(), make_env=None)
    report = check_cmdp(alone, steps=20)
    report.raise_if_failed()
    assert any(check.name == "axis 'drag' acts on the dynamics" for check in report.checks)


def test_whole_numbers_reach_the_simulator_as_such():
    kinds = []

    def apply(sail, context):
        kinds.append(jnp.result_type(context["crew"]).kind)
        return with_fields(sail, context)

    boat(grid(mbtl.Integer("crew", 1, 4)), apply=apply)
    assert {*kinds} == {"i"}


class Branching(Boat):
    def step(self, key, state, action, params):
        return super().step(key, state, action if params.drag > 0.5 else -action, params)


class Counting(Boat):
    def reset(self, key, params):
        return self.seen(jnp.zeros(2), jnp.zeros(2)), {"place": jnp.zeros(2), "speed": 0}


class Endless(Boat):
    horizon = None


class Swapped(Boat):
    def reset(self, key, params):
        return super().reset(key, params)[::-1]


class Sinking(Boat):
    def step(self, key, state, action, params):
        obs, new, reward, over = super().step(key, state, action, params)
        return obs, new, jnp.where(params.drag > 0.5, jnp.nan, reward), over


def test_trainings_that_are_lost_are_named_by_their_contexts():
    trainer = jax_problem("x", Sinking(), Sail(), AXES, timesteps=160, trainer_options=FAST).trainer
    with pytest.raises(TrainingFailed, match=r"policies of \{'drag': 0.9, .*\(2 in all\)"):
        trainer.train_many(AXES.contexts, range(4))
    with pytest.raises(TrainingFailed, match=r"by step 160; check"):
        trainer.train(AXES.contexts[3:], 0)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"horizon": 0}, "horizon of a simulator is 1 or more, got 0"),
        ({"trainer_options": {"eval_episode": 3}}, "Did you mean 'eval_episodes'"),
        ({"trainer_options": {"reward": "x"}}, "no reward of .* is called 'x'. There are none"),
        ({"trainer_options": {"actions": "x"}}, "no set of actions of .* There are none"),
    ],
)
def test_settings_that_cannot_be_are_one_sentence(settings, said):
    with pytest.raises(InvalidInput, match=said):
        boat(**settings).trainer.train(AXES.contexts[:1], 0)


@pytest.mark.parametrize(
    ("simulator", "params", "axis", "error", "said"),
    [
        (Boat(), Sail(), mbtl.Linear("drga", 0, 1), UnknownName, "Did you mean 'drag'"),
        (Boat(), SimpleNamespace(drag=1), mbtl.Linear("drag", 0, 1), UnknownName, "register_data"),
        (Boat(), Sail(), mbtl.Linear("wind[2]", 0, 1), InvalidInput, r"shape \(2,\), got 0.0"),
        (Boat(), Sail(), mbtl.Linear("wind[x]", 0, 1), InvalidInput, r"'wind\[x\]'"),
        (Boat(), Sail(), mbtl.Linear("crew", 0, 1), InvalidInput, "use mbtl.Integer"),
        (
            Boat(),
            Sail(),
            mbtl.Categorical("drag", ("a", "b")),
            InvalidInput,
            "an axis in jax is of nu",
        ),
        (Branching(), Sail(), mbtl.Linear("drag", 0, 1), InvalidInput, r"test_traced.py:\d+: Att"),
        (Endless(), Sail(), mbtl.Linear("drag", 0, 1), InvalidInput, "whole number, got None"),
        (Counting(), Sail(), mbtl.Linear("drag", 0, 1), InvalidInput, "keep their shapes"),
        (Swapped(), Sail(), mbtl.Linear("drag", 0, 1), InvalidInput, r"reset gives \(observation"),
        (object(), Sail(), mbtl.Linear("drag", 0, 1), InvalidInput, "reset, step, action, hor"),
        (Boat(), None, mbtl.Linear("drag", 0, 1), UnknownName, "'drag'"),
    ],
)
def test_what_cannot_be_an_axis_or_a_simulator_is_one_sentence(
    simulator, params, axis, error, said
):
    space = grid(axis, n=getattr(axis, "choices", 2))
    with pytest.raises(error, match=said) as raised:
        jax_problem("x", simulator, params, space, timesteps=100)
    assert "\n" not in str(raised.value)


# ---- gymnax's interface, with and without gymnax -------------------------------------------------


@jax.tree_util.register_dataclass
@dataclass
class Clock:
    start: float = 0.0
    max_steps_in_episode: int = 3


class OldClock:
    """As before gymnax 1.0: `done` is also that time is up. It ends by itself at 2, if it can."""

    def action_space(self, params):
        return SimpleNamespace(n=2)

    def reset_env(self, key, params):
        return jnp.zeros(1), SimpleState(jnp.int32(0), params.start + 0.0)

    def step_env(self, key, state, action, params):
        new = SimpleState(state.time + 1, state.value + 1.0)
        done = (new.value == 2.0) | (new.time >= params.max_steps_in_episode)
        return jnp.array([new.value]), new, 1.0, done, {}


class NewClock(OldClock):
    """Since 1.0 it says only that it has ended by itself."""

    def is_truncated(self, state, params):
        return state.time >= params.max_steps_in_episode

    def step_env(self, key, state, action, params):
        obs, new, reward, _, info = super().step_env(key, state, action, params)
        return obs, new, reward, new.value == 2.0, info


@jax.tree_util.register_dataclass
@dataclass
class SimpleState:
    time: Any
    value: Any
    nothing: Any = field(default_factory=lambda: jnp.zeros((0, 2)))


@pytest.mark.parametrize("clock", [OldClock(), NewClock()])
def test_the_time_limit_is_no_terminal_state(clock):
    space = grid(mbtl.Linear("start", 0.0, 5.0))
    problem = jax_problem("clock", clock, Clock(), space, timesteps=100)
    assert problem.horizon == 3

    def ends(context):
        env = problem.make_env(context)
        env.reset(seed=0)
        return [env.step(0)[2:4] for _ in range(3)]

    early = ends({"start": 0.0})
    assert early[:2] == [(False, False), (True, False)]
    assert ends({"start": 5.0}) == [(False, False), (False, False), (False, True)]
    policy = problem.trainer.untrained({"start": 0.0})
    returns = problem.trainer.evaluate_many([policy], space.contexts * 2, range(4))[0]
    assert returns.tolist() == [[2.0] * 10, [3.0] * 10] * 2


def gymnax_made(name):
    gymnax = pytest.importorskip("gymnax")
    return gymnax.make(name)


@pytest.mark.parametrize(
    ("name", "axis", "kind"),
    [
        ("Pendulum-v1", mbtl.Linear("g", 5.0, 15.0), Box),
        ("Pendulum-v1", mbtl.Linear("max_torque", 1.0, 4.0), Box),
        ("CartPole-v1", mbtl.Linear("length", 0.2, 2.0), Discrete),
        ("MountainCar-v0", mbtl.Linear("force", 0.0005, 0.002), Discrete),
    ],
)
def test_rollouts_are_those_of_gymnax(name, axis, kind):
    env, params = gymnax_made(name)
    problem = jax_problem("theirs", env, params, grid(axis), timesteps=100)
    world, _ = problem.trainer.problem(problem.space.contexts)
    assert isinstance(world.action, kind)
    if axis.name == "max_torque":
        assert world.action == Box((-4.0,), (4.0,))
    rollouts = []
    for value in (axis.low, axis.high):
        ours, theirs = problem.make_env({axis.name: value}), params.replace(**{axis.name: value})
        seen = [ours.reset(seed=3)[0]]
        state = jax.tree.map(lambda x: x[0], ours._state.env.state)
        step = jax.jit(env.step_env)
        ours.action_space.seed(0)
        for _ in range(10):
            action = ours.action_space.sample()
            found = ours.step(action)
            obs, state, reward, over, _ = step(jax.random.PRNGKey(0), state, action, theirs)
            np.testing.assert_allclose(found[0], obs, rtol=1e-5, atol=1e-6)
            assert found[1] == pytest.approx(float(reward), rel=1e-5)
            assert found[2] == bool(over)
            seen.append(found[0])
        rollouts.append(np.array(seen))
    assert not np.allclose(rollouts[0][1:], rollouts[1][1:], atol=1e-7)


def test_check_finds_gymnax_fields_that_were_worked_into_others():
    env, params = gymnax_made("CartPole-v1")
    space = grid(mbtl.Linear("masscart", 0.5, 5.0))
    report = check_cmdp(jax_problem("pole", env, params, space, timesteps=100), steps=50)
    assert [check.name for check in report.failures] == ["axis 'masscart' acts on the dynamics"]

    def apply(params, context):
        return params.replace(
            masscart=context["masscart"], total_mass=context["masscart"] + params.masspole
        )

    problem = jax_problem("pole", env, params, space, timesteps=100, apply=apply)
    assert check_cmdp(problem, steps=50).ok


def test_wrappers_of_gymnax_are_refused():
    env, params = gymnax_made("CartPole-v1")
    from gymnax.wrappers import LogWrapper

    with pytest.raises(InvalidInput, match=r"without wrappers.*LogWrapper"):
        jax_problem("x", LogWrapper(env), params, grid(mbtl.Linear("gravity", 1, 9)), timesteps=9)


def test_the_examples_of_the_page_run():
    pytest.importorskip("gymnax")
    page = (blocks.ROOT / "docs" / "jax-simulators.md").read_text("utf-8")
    names = {}
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        if "brax" not in block:
            exec(block.replace("100_000", "2_000"), names)  # shorter
    assert np.isfinite(names["study"].value)


# ---- Brax ----------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore")
def test_rollouts_are_those_of_brax_and_its_environment_stays_as_it_is():
    envs = pytest.importorskip("brax.envs")
    env = envs.get_environment("inverted_pendulum", backend="spring")
    space = grid(mbtl.Linear("gravity[2]", -20.0, -5.0), mbtl.Linear("link.inertia.mass[1]", 1, 9))
    problem = jax_problem("pole", env, None, space, timesteps=100)
    assert problem.horizon == 1000
    rollouts = []
    for context in space.contexts:
        ours = problem.make_env(context)
        rows = [ours.reset(seed=1)[0]]
        state = jax.tree.map(lambda x: x[0], ours._state.env.state)
        theirs = envs.get_environment("inverted_pendulum", backend="spring")
        gravity = theirs.sys.gravity.at[2].set(context["gravity[2]"])
        theirs.sys = theirs.sys.tree_replace({"gravity": gravity})
        mass = theirs.sys.link.inertia.mass.at[1].set(context["link.inertia.mass[1]"])
        theirs.sys = theirs.sys.tree_replace({"link.inertia.mass": mass})
        step = jax.jit(theirs.step)
        for _ in range(5):
            found = ours.step([0.5])
            state = step(state, jnp.array([0.5]))
            np.testing.assert_allclose(found[0], state.obs, rtol=1e-4, atol=1e-5)
            rows.append(found[0])
        rollouts.append(np.array(rows))
    assert len({rollout[-1].tobytes() for rollout in rollouts}) == 4
    assert float(env.sys.gravity[2]) == pytest.approx(-9.81)


@pytest.mark.filterwarnings("ignore")
def test_wrappers_of_brax_are_refused():
    envs = pytest.importorskip("brax.envs")
    wrapped = envs.create("inverted_pendulum", backend="spring")
    with pytest.raises(InvalidInput, match="without wrappers"):
        jax_problem("x", wrapped, None, grid(mbtl.Linear("gravity[2]", -9, -1)), timesteps=9)
