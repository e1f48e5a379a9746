import numpy as np
import pytest

import mbtl
from mbtl.report import next_training, reference_curves, summarise_study
from mbtl.report.summary import policies_enough
from mbtl.report.text import lines

N = 20
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0, unit="m"): N})


def row(source):
    return 0.9 - 0.02 * np.abs(source - np.arange(N))


def study_of(picks, episodes=1, **settings):
    study = mbtl.create_study(
        SPACE, budget=6, bounds=(0.0, 1.0), problem="toy", selector="mbtl", **settings
    )
    for _ in range(picks):
        pick = study.ask()
        study.tell(pick, np.repeat(row(pick.source)[:, None], episodes, axis=1))
    return study


def test_numbers_of_a_known_study():
    summary = summarise_study(study_of(4))
    assert [p.source for p in summary.picks] == [9, 19, 0, 14]
    assert summary.value == pytest.approx(np.max([row(s) for s in (9, 19, 0, 14)], axis=0).mean())
    assert summary.best_single == 9
    assert summary.best_single_value == pytest.approx(row(9).mean())
    assert summary.serving == tuple([0] * 5 + [9] * 7 + [14] * 5 + [19] * 3)
    assert summary.next_source in set(range(N)) - {0, 9, 14, 19}
    assert 0 <= summary.next_gain <= 0.9 - summary.value  # no more than the best ever seen
    assert summary.finished is None


def test_one_more_training_is_predicted_beyond_a_spent_budget_until_no_context_is_left():
    study = study_of(2, costs=np.ones(N), cost_budget=2.0)
    assert study.is_finished
    assert summarise_study(study).next_source not in (None, 9, 19)
    study = mbtl.create_study(SPACE, budget=N, bounds=(0.0, 1.0), selector="random", problem="toy")
    for source in range(N):
        study.tell(source, row(source))
    summary = summarise_study(study)
    assert (summary.next_source, summary.next_gain) == (None, None)


def test_the_next_training_says_what_it_adds_and_how_sure_that_is():
    study = study_of(4)
    found, summary = next_training(study), summarise_study(study)
    assert (found.source, found.gain) == (summary.next_source, summary.next_gain)
    assert found.context == SPACE.context(found.source)
    assert 0.0 <= found.low <= found.high <= 0.9 - summary.value + 0.1
    assert 0.0 <= found.chance <= 1.0
    assert f"between {found.low:.4f} and {found.high:.4f}" in str(found)
    assert next_training(study_of(0)) is None


def test_nothing_to_gain_is_said_so():
    study = mbtl.create_study(SPACE, budget=6, bounds=(0.0, 1.0))
    for source in (3, 9, 15):
        study.tell(source, np.ones(N))
    assert str(next_training(study)) == "One more training is predicted to add nothing to V."


def test_the_worst_served_context_is_named():
    study = study_of(2)  # at 9 and 19: context 0 is farthest from both
    summary = summarise_study(study)
    assert (summary.worst_context, summary.worst_context_value) == (0, pytest.approx(0.72))
    assert "; the worst context, x = 0 m, at 0.7200." in " ".join(lines(summary, SPACE))


def test_a_study_without_rows_has_a_summary():
    summary = summarise_study(study_of(0))
    assert summary.value is None
    assert "No policy" in summary.verdict
    assert summary.to_json()["picks"] == ()


def test_failures_and_open_picks_are_listed():
    study = study_of(1)
    study.fail(study.ask(), "diverged")
    study.ask()
    statuses = [p.status for p in summarise_study(study).picks]
    assert statuses == ["told", "failed: diverged", "open"]


def test_a_study_whose_last_pick_is_open_is_not_finished():
    study = study_of(5)
    last = study.ask()
    assert summarise_study(study).finished is None
    study.tell(last, row(last.source))
    assert summarise_study(study).finished == "the budget of 6 trainings is spent"


def test_fresh_episodes_are_the_headline_when_measured():
    study = study_of(4)
    study.record_fresh_returns(np.array([r.returns for r in study.state.rows]) - 0.1)
    summary = summarise_study(study)
    assert summary.fresh_value == pytest.approx(summary.value - 0.1)
    assert f"V = {summary.fresh_value:.4f} (one episode each, so its error is unknown) on" in (
        " ".join(lines(summary, SPACE))
    )


def test_verdict_tells_one_policy_from_many():
    flat = mbtl.create_study(SPACE, budget=3, bounds=(0.0, 1.0), selector="mbtl")
    for _ in range(3):
        flat.tell(flat.ask(), np.full((N, 2), 0.8))
    assert summarise_study(flat).verdict.startswith("One policy would do")
    assert summarise_study(study_of(4, episodes=2)).verdict.startswith("One policy would not do")


def test_verdict_is_silent_where_chance_decides():
    assert "cannot be said from one episode" in summarise_study(study_of(4)).verdict
    rng = np.random.default_rng(0)
    noisy = mbtl.create_study(SPACE, budget=3, bounds=(0.0, 1.0), selector="mbtl")
    for _ in range(3):
        noisy.tell(noisy.ask(), 0.8 + 0.3 * rng.standard_normal((N, 3)))
    summary = summarise_study(noisy)
    assert summary.verdict.startswith("Whether one policy would do is within the noise")
    assert summary.single_gain_margin > 0.01


def test_fewest_policies_for_nearly_all_the_gain():
    rows = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.9, 0.9, 0.9]])
    weights = np.full(3, 1 / 3)
    assert policies_enough(rows[3:], weights) == 1
    assert policies_enough(rows[:3], weights) == 3
    assert policies_enough(np.array([[0.5, 0.5], [0.5, 0.5]]), np.full(2, 0.5)) == 1


def test_reference_curves_need_the_same_recipe(tmp_path, monkeypatch):
    from mbtl.benchmark import TransferMatrix, save_shipped, shipped

    rng = np.random.default_rng(0)
    returns = np.array([[row(s) for s in range(N)]] * 2) + 0.01 * rng.standard_normal((2, N, N))
    seeds = {"seeds": [{"recipe": {"timesteps": 5}}] * 2}
    matrix = TransferMatrix.of(returns, space=SPACE, bounds=(0, 1), provenance=seeds)
    save_shipped(matrix, tmp_path, "toy")
    monkeypatch.setattr(
        "mbtl.report.reference.shipped_matrices", lambda: shipped.shipped_matrices(tmp_path)
    )
    monkeypatch.setattr(
        "mbtl.report.reference.load_matrix", lambda name: shipped.load_matrix(name, folder=tmp_path)
    )
    assert reference_curves(study_of(1)) is None
    assert reference_curves(study_of(1, settings={"recipe": {"timesteps": 6}})) is None
    same = reference_curves(study_of(1, settings={"recipe": {"timesteps": 5}}))
    assert same.random.shape == same.greedy.shape == same.oracle.shape == (2, 6)
    assert (same.oracle[:, -1] >= same.random[:, -1]).all()
    assert list(same.baselines) == ["Random", "Greedy", "Sequential Oracle"]
    grand_mean = returns.mean()
    assert f"random policy {grand_mean:.4f}." in same.said


def test_report_portfolio_and_fresh_episodes_follow_the_same_routes_also_where_policies_tie():
    """Two policies that are equally good in the episodes seen; afresh each is good near its own."""
    study = mbtl.create_study(SPACE, budget=2, bounds=(0.0, 1.0), selector="mbtl")
    sources = []
    for _ in range(2):
        pick = study.ask()
        sources.append(pick.source)
        study.tell(pick, np.full((N, 2), 0.9))
    fresh = np.array([np.where(abs(np.arange(N) - s) < N / 2, 1.0, 0.0) for s in sources])
    portfolio = study.portfolio()
    nearest = np.abs(np.arange(N)[:, None] - np.array(sources)).argmin(axis=1)
    assert portfolio.assignment.tolist() == nearest.tolist()
    study.record_fresh_returns(fresh)
    summary = summarise_study(study)
    assert summary.serving == tuple(sources[i] for i in nearest)
    assert summary.fresh_value == pytest.approx(fresh[nearest, np.arange(N)].mean())
    for k in (1, 2):  # and so for every prefix
        assert study.routing.routes[k - 1].max() < k
