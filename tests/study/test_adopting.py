"""Policies that a user has already are taken in as rows, and serve like any other."""

import numpy as np
import pytest

import mbtl
from mbtl.report import of_study, page

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 10.0): 6})


def train(contexts, seed, *, start=None, length=None):
    begun = [] if start is None else [f"from {start}"]
    return " ".join([str(np.mean([context["x"] for context in contexts])), *begun])


def evaluate(policy, contexts, seeds):
    home = float(policy.split()[0])
    return np.array([[10.0 - abs(context["x"] - home)] * 2 for context in contexts])


def save(policy, folder):
    (folder / "policy").write_text(policy)


def load(folder):
    return (folder / "policy").read_text()


@pytest.fixture
def study(tmp_path):
    problem = mbtl.CMDP.from_functions(
        "toy", SPACE, train=train, evaluate=evaluate, save=save, load=load, bounds=(0.0, 10.0)
    )
    return mbtl.create_study(problem, budget=1, strategy="mbtl", storage=tmp_path / "study.db")


def test_it_is_saved_evaluated_and_serves_and_the_budget_stays_whole(study, tmp_path):
    study.adopt("8.0 mine", {"x": 8.0})
    again = mbtl.load_study(tmp_path / "study.db")
    assert again.portfolio(study.trainer).policy_for({"x": 10.0}) == "8.0 mine"
    assert (len(study.state.rows), study.state.paid) == (1, 0.0)
    study.run(progress=False)
    assert len(study.state.rows) == 2
    assert study.portfolio().policy_for({"x": 8.0}) == "8.0 mine"
    assert "mbtl, 1 training, 1 policy of yours, " in page([of_study(study)])


def test_one_of_several_contexts_is_a_set(study):
    study.adopt("4.0 mine", [{"x": 0.0}, {"x": 4.0}, {"x": 8.0}])
    assert study.history.made(0).contexts == (0, 2, 4)


def test_it_is_evaluated_where_all_are_and_not_again_where_it_is_known():
    played = []

    def counting(policy, contexts, seeds):
        played.append(len(contexts))
        return evaluate(policy, contexts, seeds)

    problem = mbtl.CMDP.from_functions(
        "toy", SPACE, train=train, evaluate=counting, bounds=(0.0, 10.0)
    )
    study = mbtl.create_study(problem, budget=1, evaluation=mbtl.Evaluation(3))
    study.adopt("8.0 mine", {"x": 8.0})
    assert np.isfinite(study.state.rows[0].returns[4])
    with pytest.raises(mbtl.StudyError, match="was told before"):
        study.adopt("8.0 mine", {"x": 8.0})
    assert played == [3]


def test_a_context_that_is_none_is_refused_before_anything_is_played(study):
    with pytest.raises(mbtl.MbtlError, match="not one of the 6 contexts"):
        study.adopt(None, {"x": 7.7})
    with pytest.raises(mbtl.InvalidInput, match="load it first"):
        study.adopt("mine.zip", {"x": 0.0})
    bare = mbtl.create_study(SPACE, budget=1)
    with pytest.raises(mbtl.InvalidInput, match="give trainer="):
        bare.adopt("1.0", {"x": 0.0})


def test_a_zip_of_stable_baselines3_is_a_first_row(tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    gym = pytest.importorskip("gymnasium")
    model = sb3.PPO("MlpPolicy", gym.make("CartPole-v1"), n_steps=32, batch_size=32, device="cpu")
    model.save(tmp_path / "mine.zip")
    problem = mbtl.CMDP.from_env(
        "poles", mbtl.ContextSpace.grid({mbtl.Linear("length", 0.2, 1.0): 3}),
        make_env=lambda context: gym.make("CartPole-v1"), timesteps=32, eval_episodes=2,
    )  # fmt: skip
    study = mbtl.create_study(problem, budget=1, storage=tmp_path / "s.db", strategy="mbtl")
    study.adopt(sb3.PPO.load(tmp_path / "mine.zip", device="cpu"), problem.space.contexts)
    safe = mbtl.load_study(tmp_path / "s.db").portfolio()  # its numpy copy: nothing is executed
    assert safe.trained_on(0) == "all contexts"
    seen = np.zeros(4, np.float32)
    mine, _ = model.predict(seen, deterministic=True)
    assert safe.policy_for({"length": 0.5}).predict(seen)[0] == mine
