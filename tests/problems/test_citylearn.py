"""The page on CityLearn; where the package and its data are installed."""

import blocks
import numpy as np
import pytest

import mbtl

data = pytest.importorskip("citylearn.data")
pytest.importorskip("stable_baselines3")
PAGE = (blocks.ROOT / "docs" / "citylearn.md").read_text(encoding="utf-8")
SHORTER = {"not run: needs CityLearn": "", "timesteps=4_000": "timesteps=336"}
SHORTER |= {"eval_episodes=4": "eval_episodes=1", "budget=3": "budget=1"}


@pytest.fixture
def page(tmp_path, monkeypatch):
    """The page with short trainings, in an empty folder to work in."""
    try:
        data.DataSet(offline=True).get_schema("citylearn_challenge_2022_phase_1")
    except data.OfflineDataError as missing:  # CITYLEARN_LOCAL_DATASETS_PATH says where they are
        pytest.skip(str(missing))
    text = PAGE
    for said, short in SHORTER.items():
        assert said in text
        text = text.replace(said, short)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "page.md").write_text(text, encoding="utf-8")
    return tmp_path / "page.md"


def week(env, seed, charge=0.2):
    """First observation, rewards and `info` of an episode: six hours in, six hours out."""
    first, _ = env.reset(seed=seed)
    rewards, ended = [], False
    while not ended:
        _, reward, terminated, ended, info = env.step(
            np.full(1, charge * (-1) ** (len(rewards) // 6))
        )
        assert not terminated
        rewards.append(reward)
    return first, np.array(rewards), info


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.usefixtures("undrawn")
def test_the_page_runs_and_both_axes_reach_a_week_that_its_seed_draws(page):
    blocks.execute(page)
    from house import make_env, problem

    found = {check.name: check.outcome for check in mbtl.check_cmdp(problem).checks}
    for axis in ("battery", "solar"):
        assert found[f"axis {axis!r} acts on the dynamics"] == "passed"
    env = make_env({"battery": 4.0, "solar": 8.0})
    first, rewards, info = week(env, 1)
    assert len(rewards) == 7 * 24
    assert sum(rewards) == pytest.approx(info["saved"], abs=1e-3)
    assert week(env, 1, charge=0.0)[2]["saved"] == pytest.approx(0.0, abs=1e-5)
    assert not np.array_equal(week(env, 2)[0], first)
    np.testing.assert_array_equal(week(env, 1)[1], rewards)
    for other in ({"battery": 12.0, "solar": 8.0}, {"battery": 4.0, "solar": 0.0}):
        assert not np.allclose(week(make_env(other), 1)[1], rewards)
