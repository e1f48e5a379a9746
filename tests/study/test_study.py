"""Ask and tell: what a study proposes, takes, refuses, and where it ends."""

from pathlib import Path

import numpy as np
import pytest
from line_problem import line

import mbtl
from flat import created, told
from mbtl.errors import InvalidInput, StudyError, StudyMismatch, TrainingFailed
from mbtl.seeds import training_seed
from mbtl.selectors import MBTL
from mbtl.study import StudyFinished
from mbtl.study.events import Event

N = 20
SPACE = line(N)


def row(source, theta=0.02):
    return 0.9 - theta * np.abs(source - np.arange(N))


def new(tmp_path=None, **settings):
    settings = {"budget": 6, "bounds": (0.0, 1.0), "strategy": "mbtl", **settings}
    return created(SPACE, storage=tmp_path / "study.db" if tmp_path else None, **settings)


def test_the_training_seed_belongs_to_the_source_not_to_the_pick():
    for selector in ("mbtl", "equidistant"):
        study = new(strategy=selector, seed=3, trial=1)
        for _ in range(6):
            pick = study.ask()
            assert pick.seed == training_seed(3, 1, pick.source)
            study.tell(pick, row(pick.source))


def test_a_study_loaded_again_goes_on_the_same(tmp_path):
    undisturbed = told(new(), row, 6)
    told(new(tmp_path), row, 3)
    resumed = told(mbtl.load_study(tmp_path), row, 3)
    assert [p.source for p in resumed.state.picks] == [p.source for p in undisturbed.state.picks]
    assert np.array_equal(resumed.curve, undisturbed.curve)


def test_going_on_without_a_name_finds_the_only_study_of_a_file_and_no_other(tmp_path):
    again = {"budget": 6, "storage": tmp_path / "study.db", "load_if_exists": True}
    first = created(SPACE, name="mine", **again)
    assert created(SPACE, **again).name == "mine"
    with pytest.raises(StudyMismatch, match=r"a stored study \('mine'\) goes on only with"):
        created(SPACE, strategy="random", **again)
    created(SPACE, name="theirs", **again)
    assert created(SPACE, **again).name == "study"
    assert first.name == "mine"


def test_a_budget_of_trainings_or_of_cost_ends_the_study():
    study = told(new(budget=3), row, 3)
    assert study.is_finished
    with pytest.raises(StudyFinished, match="budget of 3 trainings is spent"):
        study.ask()
    study = new(cost_budget=5.0)
    for source in (0, 1, 2, 3):
        study.tell(source, row(source))  # nobody asked for it, so it costs nothing
    assert (study.state.cost, study.stop_reason) == (0.0, None)
    study.tell(study.ask(), row(9), cost=2.5)
    study.tell(4, row(4), cost=2.5)  # unless it is told
    with pytest.raises(StudyFinished, match="cost 5 reaches the budget of 5"):
        study.ask()


def test_telling_a_source_that_is_pending_answers_its_pick():
    study = new()
    pick = study.ask()
    study.tell(pick.source, row(pick.source))
    assert not study.state.open_picks
    assert not study.tell(pick, row(pick.source))  # somebody else was faster
    assert len(study.state.rows) == 1
    with pytest.raises(StudyError, match="told before"):
        study.tell(pick.source, row(pick.source))


@pytest.mark.parametrize(
    ("returns", "words"),
    [
        (np.full(N, np.nan), "got NaN in all of 20"),
        (np.r_[np.zeros(N - 1), np.inf], "the first of 1 of"),
        (np.zeros(N + 1), r"shape \(20,\)"),
        (np.zeros((N, 2, 2)), "shape"),
        (np.zeros((N, 0)), "shape"),
        (["a"] * N, "numbers"),
        (None, "NaN"),
    ],
)
def test_unusable_returns_are_refused_and_the_pick_stays_open(returns, words):
    study = told(new(), row, 1)
    pick = study.ask()
    before = study.state.seq
    with pytest.raises(TrainingFailed, match=words if returns is not None else "shape|NaN"):
        study.tell(pick, returns)
    assert study.state.seq == before
    study.tell(pick, row(pick.source))
    assert len(study.history) == 2


def test_minimising_picks_as_maximising_the_mirror():
    up, down = new(), new(direction="minimize")
    for _ in range(6):
        a, b = up.ask(), down.ask()
        assert a.source == b.source
        up.tell(a, row(a.source))
        down.tell(b, 1.0 - row(b.source))
    assert down.curve == pytest.approx(up.curve)


def test_automatic_bounds_move_with_the_rows_and_never_change_past_picks(tmp_path):
    study = new(tmp_path, bounds=None)
    rng = np.random.default_rng(0)
    told(study, lambda source: 1000 * row(source) * rng.uniform(0.1, 3), 6)
    rows = np.array([r.returns for r in study.state.rows])
    assert (study.bounds.low, study.bounds.high) == (rows.min(), rows.max())
    again = mbtl.load_study(tmp_path)
    assert again.state.picks == study.state.picks


def test_a_stored_study_refuses_other_settings(tmp_path):
    new(tmp_path)
    changes = [{"budget": 5}, {"seed": 1}, {"strategy": "greedy"}, {"bounds": (0, 2)}]
    for change in (*changes, {"strategy": MBTL(warm_up=1)}, {"problem": "x"}):
        with pytest.raises(StudyMismatch, match="--new"):
            new(tmp_path, load_if_exists=True, **change)
    assert new(tmp_path, load_if_exists=True).spec.budget == 6
    with pytest.raises(StudyError, match="exists"):
        new(tmp_path)


def test_a_stored_study_says_which_cost_differs_and_no_long_value_whole(tmp_path):
    costs = np.arange(1.0, N + 1)
    new(tmp_path, cost_budget=50.0, costs=costs, settings={"note": "n" * 400})
    for note, there, words in (
        ("n" * 400, 0.5, r"costs\.7 was 8\.0, got 0\.5"),
        ("m", 8.0, r"settings\.note was 'n{56}\.\.\., got 'm'"),
    ):
        costs[7] = there
        given = {"costs": costs, "settings": {"note": note}, "load_if_exists": True}
        with pytest.raises(StudyMismatch, match=words):
            new(tmp_path, cost_budget=50.0, **given)


X = mbtl.Linear("x", 0.0, 1.0)


def test_a_stored_study_says_what_differs_in_another_space(tmp_path):
    grid, study = mbtl.ContextSpace.grid, new(tmp_path)
    for other, words in (
        (grid({mbtl.Linear("y", 0.0, 1.0, "m"): N}), r"the space was \['x'\], got \['y \[m\]'\]"),
        (grid({mbtl.Linear("x", 0.0, 2.0): N}), r"axis 'x', high was 1\.0, got 2\.0"),
        (grid({mbtl.Log("x", 0.1, 1.0): N}), "axis 'x', kind was 'linear', got 'log'"),
        (grid({X: N - 1}), "number of contexts was 20, got 19"),
        (grid({X: np.linspace(0, 1, N) ** 2}), r"index 1 was {'x': 0\.05\d*}, got {'x': 0\.002"),
        (grid({X: N}, weights=np.arange(1, N + 1)), r"of {'x': 0\.0} was 0\.05, got 0\.0047"),
        (mbtl.ContextSpace.points([X], study.space.contexts), "was 'a grid', got 'a list'"),
    ):
        settings = {"storage": tmp_path / "study.db", "load_if_exists": True}
        with pytest.raises(StudyMismatch, match=words):
            created(other, budget=6, bounds=(0, 1), **settings)


def test_a_leading_tilde_is_the_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("USERPROFILE", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    study = created(SPACE, budget=1, storage="~/a/study.db", artifacts="~/policies")
    study.tell(0, np.zeros(N))
    assert study.folder == tmp_path / "home" / "policies"
    assert [path.name for path in tmp_path.iterdir()] == ["home"]
    for place in ("~/a", "~/a/study.db", Path("~/a")):
        assert len(mbtl.load_study(place).state.rows) == 1


@pytest.mark.parametrize("selector", ["greedy", "equidistant"])
def test_a_selector_of_one_axis_refuses_others_before_there_is_a_database(tmp_path, selector):
    road = mbtl.Categorical("road", ("dry", "wet"))
    for axes, words in (({X: 3, road: 2}, "x, road"), ({road: 2}, "road")):
        space = mbtl.ContextSpace.grid(axes)
        with pytest.raises(InvalidInput, match=f"on one numeric axis, got {words}; choose"):
            created(space, budget=2, strategy=selector, storage=tmp_path / "s.db")
    assert not (tmp_path / "s.db").exists()


# ---- what real studies need --------------------------------------------------------------------


def test_ask_gives_several_picks_that_differ():
    study = new(strategy="auto")
    picks = study.ask(4)
    assert len({pick.source for pick in picks}) == 4
    for pick in reversed(picks):
        study.tell(pick, row(pick.source))
    assert [pick.number for pick in study.ask(5)] == [4, 5]  # what is left of six
    with pytest.raises(StudyFinished, match="2 picks are still under way"):
        study.ask(2)
    with pytest.raises(InvalidInput, match="a whole number of picks, 1 or more"):
        study.ask(0)


def test_costs_known_before_keep_the_study_within_its_budget():
    study = new(strategy="auto", costs=lambda c: 1.0 + 9.0 * (c["x"] > 0.5), cost_budget=12.5)
    told(study, row, 4)
    dear = [source >= 10 for source in study.history.sources]
    assert [r.cost for r in study.state.rows] == [10.0 if d else 1.0 for d in dear]
    assert study.state.cost <= 12.5
    study = new(costs=np.full(N, 10.0), cost_budget=13.0)
    study.ask()  # a pick under way has its cost set aside
    with pytest.raises(StudyFinished, match=r"costs more than the 3 that remain of 13"):
        study.ask()


def test_policies_evaluated_on_a_few_targets_only():
    study = new(strategy="auto", eval_targets=6)
    for _ in range(4):
        pick = study.ask()
        assert len(pick.targets) == 6
        assert pick.source in pick.targets
        study.tell(pick, row(pick.source)[list(pick.targets)])
    rows = study.history.rows
    assert (np.isfinite(rows).sum(axis=1) == 6).all()
    truth = np.max([row(s) for s in study.history.sources], axis=0).mean()
    assert study.value == pytest.approx(truth, abs=0.05)
    assert (np.diff(study.curve) >= 0).all()
    assert study.portfolio().routing.route.shape == (N,)
    study.tell(0, [0.5, 0.6], targets=[0, 19])
    assert study.history.rows[-1, 19] == 0.6
    for wrong in ([], [3, 3], [20], [-1]):
        with pytest.raises(InvalidInput, match="distinct context indices from 0 to 19"):
            study.tell(1, [0.5] * len(wrong), targets=wrong)


def test_a_study_of_the_worst_share_values_it():
    study = new(strategy="auto", risk=0.1)
    told(study, row, 3)
    best = np.max([row(s) for s in study.history.sources], axis=0)
    assert study.value == pytest.approx(np.sort(best)[:2].mean())


def test_the_study_ends_when_all_that_is_left_is_predicted_to_gain_little(tmp_path):
    study = new(tmp_path, strategy="auto", budget=20, stop_left=0.02, stop_confidence=0.8)
    with pytest.raises(StudyFinished, match=r"left together gain less than 0\.02"):
        told(study, row, 20)
    done = len(study.state.rows)
    assert 1 < done < 15
    assert study.is_finished
    again = mbtl.load_study(tmp_path)
    assert again.is_finished
    assert "gain less than" in again.stop_reason
    again.tell(0, row(0))  # news: it asks the selector once more
    assert again.stop_reason is None


def test_a_study_that_ended_early_goes_on_when_all_is_to_be_spent(tmp_path):
    same = {"strategy": "auto", "budget": 20, "stop_confidence": 0.8}
    study = new(tmp_path, stop_left=0.02, **same)
    with pytest.raises(StudyFinished, match="left together gain less"):
        told(study, row, 20)
    assert new(tmp_path, **same, load_if_exists=True).stop_reason is None
    assert mbtl.load_study(tmp_path).spec.stop_left is None
    study.refresh()
    assert study.stop_reason is None


def test_a_study_that_reached_its_level_goes_on_to_another_one_or_to_the_end(tmp_path):
    study = new(tmp_path, stop_value=0.01, stop_left=0.001)
    told(study, row, 1)
    assert "reaches the level 0.01" in study.stop_reason
    with pytest.raises(StudyMismatch, match=r"stop_value was 0\.01, got None .*run --all"):
        new(tmp_path, stop_left=0.001, load_if_exists=True)
    further = new(tmp_path, stop_value=0.99, stop_left=0.001, load_if_exists=True)
    assert (further.spec.stop_value, further.spec.stop_left) == (0.99, 0.001)
    assert further.stop_reason is None
    assert new(tmp_path, load_if_exists=True).stop_reason is None
    assert mbtl.load_study(tmp_path).spec.stop_value is None


def test_scatter_of_episodes_reaches_the_selector_as_standard_errors():
    study = new(bounds=(0.0, 2.0))
    episodes = np.stack([row(9) - 0.3, row(9), row(9) + 0.3], axis=1)
    study.tell(study.ask(), episodes)
    assert study.history.errors == pytest.approx(
        episodes.std(axis=1, ddof=1) / np.sqrt(3) / 2.0 * np.ones((1, N))
    )
    assert told(new(), row, 1).history.errors is None


def test_a_failed_pick_takes_back_what_was_predicted_with_it():
    study = told(new(strategy="auto", budget=20, stop_left=0.02, stop_confidence=0.8), row, 2)
    pick = study.ask()
    study._commit(lambda state: Event("stopped", {"reason": "it seemed so"}))
    assert study.stop_reason == "it seemed so"
    study.fail(pick, "out of memory")
    assert study.stop_reason is None


def test_a_pick_given_back_is_not_begun_again_where_the_budget_cannot_pay_it():
    study = new(costs=np.full(N, 4.0), cost_budget=12.0)
    first, second = study.ask(2)
    study.tell(first, row(first.source), cost=11.0)
    study.release(second)
    with pytest.raises(StudyFinished, match="given back cost more than is left of 12"):
        study.ask()
    assert study.is_finished


def test_a_pick_told_by_its_context_has_the_targets_it_was_asked_with():
    study = new(strategy="auto", eval_targets=4)
    pick = study.ask()
    study.tell(pick.context, np.repeat(row(pick.source)[list(pick.targets), None], 2, axis=1))
    assert np.isfinite(study.history.rows[0]).sum() == 4
    assert np.isnan(study.state.rows[0].std).sum() == N - 4


def test_portfolio_and_study_agree_on_rows_that_are_partial():
    study = told(new(strategy="auto", eval_targets=5), row, 4)
    portfolio = study.portfolio()
    assert portfolio.value == pytest.approx(study.value)
    assert portfolio.routing.route.tolist() == study.routing.route.tolist()
    assert portfolio.routing.believed == pytest.approx(study.routing.believed)
    shown = portfolio.explain(SPACE.context(1))
    assert shown.basis == "predicted"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"budget": 0}, "budget must be 1 or more units"),
        ({"budget": 21, "strategy": "mbtl"}, "budget must be from 1"),
        ({"budget": 2.5}, "budget must be a whole number, got 2.5"),
        ({"budget": True}, "budget must be a whole number, got True"),
        ({"best_return": -1.0}, "counts as 0, got -1 with bounds"),
        ({"seed": -1}, ">= 0"),
        ({"seed": "a"}, "seed must be a whole number"),
        ({"strategy": "mbtll"}, "Did you mean 'mbtl'"),
        ({"bounds": (1.0, 0.0)}, "low < high"),
        ({"bounds": 5}, "two numbers"),
        ({"bounds": (0, 1, 2)}, "two numbers"),
        ({"bounds": ("a", 1)}, "two numbers"),
        ({"bounds": (-1e308, 1e308)}, "finite, .* low < high"),
        ({"direction": "upwards"}, "'maximize' or 'minimize'"),
        ({"theta": -1.0}, "theta"),
        ({"theta": np.nan}, "theta must be finite, from"),
        ({"theta": "steep"}, "theta must be a number"),
        ({"bounds": None, "stop_value": 0.5}, "needs bounds"),
        ({"bounds": None, "stop_left": 0.01}, "left of Stopping"),
        ({"stop_left": -1.0}, "left of Stopping"),
        ({"stop_left": 0.02, "stop_confidence": 1.0}, "probability in"),
        ({"stop_left": float("inf")}, "left of Stopping must be finite and > 0"),
        ({"stop_value": np.nan}, "value of Stopping must be finite, from"),
        ({"stop_value": 1.5}, r"at most 1 \(the better bound\), got 1.5"),
        ({"risk": "x"}, "risk must be a number"),
        ({"risk": 1.1}, "share of the worst targets"),
        ({"risk": 0}, "risk must be finite and > 0"),
        ({"cost_budget": 0.0}, "total of Cost"),
        ({"cost_budget": float("inf")}, "total of Cost is a finite number > 0"),
        ({"costs": [1.0, 2.0], "cost_budget": 9.0}, "one per context, got"),
        ({"costs": np.zeros(N), "cost_budget": 9.0}, "20 numbers from 1e-30"),
        ({"costs": [1.0] * 19 + [np.nan], "cost_budget": 9.0}, "got nan for x = 1"),
        ({"costs": -np.ones(N), "cost_budget": 9.0}, "from -1 to -1"),
        ({"costs": [1e-200, 1e200] + [1.0] * 18, "cost_budget": 9.0}, "from 1e-30 to 1e\\+30"),
        ({"eval_targets": 900}, "evaluated on 2 to 20 targets, got 900"),
        ({"eval_targets": 0}, "evaluated on 2 to 20 targets, got 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused_and_leave_nothing_behind(
    tmp_path, settings, words
):
    with pytest.raises(InvalidInput, match=words):
        new(tmp_path, **{"strategy": "auto", **settings})
    assert not (tmp_path / "study.db").exists()


# ---- where studies end --------------------------------------------------------------------------


def study_of(**settings):
    return new(**{"budget": 8, "bounds": (0.0, 500.0), "strategy": "specialists", **settings})


def tell(study, level, episodes=2, noise=0.0):
    pick = study.ask()
    rng = np.random.default_rng(pick.source)
    study.tell(pick, level + noise * rng.standard_normal((N, episodes)))


def test_a_study_ends_where_v_is_as_large_as_it_can_be():
    study = study_of(stop_left=0.005, best_return=500.0, strategy="mbtl")
    tell(study, 490.0)
    assert study.stop_reason is None
    tell(study, 498.0)
    assert study.stop_reason == "V = 0.9960 is within 0.005 of the largest there can be, 1"
    with pytest.raises(StudyFinished):
        study.ask()

    small = study_of(stop_left=0.005, best_return=0.0, direction="minimize")
    tell(small, 1.0)
    assert "within 0.005 of the largest" in small.stop_reason
    unasked = study_of(strategy="mbtl")
    tell(unasked, 500.0)
    assert unasked.stop_reason is None
    rounded = study_of(stop_left=0.005, best_return=50.0, bounds=(0.0, 50.0), strategy="mbtl")
    tell(rounded, 500.0 * float(np.float32(0.1)))  # a little more than there is
    assert "within 0.005 of the largest" in rounded.stop_reason
    wrong = study_of(stop_left=0.005, best_return=300.0, strategy="mbtl")
    tell(wrong, 400.0)  # more than there can be
    assert wrong.stop_reason is None


def test_a_study_goes_on_while_other_contexts_promise_something():
    study, place = study_of(stop_left=0.005), np.arange(N)[:, None] * np.ones(2)
    told(study, lambda source: 450.0 * np.exp(-np.square((place - source) / 1.5)), 4)
    assert study.stop_reason is None
    study.ask()


def test_a_lucky_mean_does_not_reach_a_level():
    lucky = study_of(stop_value=0.8, strategy="mbtl")
    tell(lucky, 405.0, episodes=3, noise=120.0)
    now = lucky.routing.value
    assert now.error > 0.01
    assert now.value - 1.28 * now.error < 0.8
    assert lucky.stop_reason is None
    sure = study_of(stop_value=0.8, strategy="mbtl")
    tell(sure, 405.0)
    assert sure.stop_reason == "V = 0.8100 reaches the level 0.8"
