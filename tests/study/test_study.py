import numpy as np
import pytest

import mbtl
from mbtl.errors import InvalidInput, StudyError, StudyMismatch, TrainingFailed
from mbtl.history import History
from mbtl.seeds import training_seed
from mbtl.selectors import MBTL, Proposal, SelectionProblem
from mbtl.study import StudyFinished

N = 20
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): N})


def row(source, theta=0.02):
    return 0.9 - theta * np.abs(source - np.arange(N))


def told(study, picks):
    for _ in range(picks):
        pick = study.ask()
        study.tell(pick, row(pick.source))
    return study


def new(tmp_path=None, **settings):
    settings = {"budget": 6, "bounds": (0.0, 1.0), **settings}
    return mbtl.create_study(SPACE, storage=tmp_path / "study.db" if tmp_path else None, **settings)


def test_ask_and_tell_play_the_selector():
    study = told(new(), 4)
    assert [pick.source for pick in study.state.picks] == [9, 19, 0, 14]
    assert study.curve[-1] == pytest.approx(np.max([row(s) for s in (9, 19, 0, 14)], axis=0).mean())


def test_the_training_seed_belongs_to_the_source_not_to_the_pick():
    for selector in ("mbtl", "equidistant"):
        study = new(selector=selector, seed=3, trial=1)
        for _ in range(6):
            pick = study.ask()
            assert pick.seed == training_seed(3, 1, pick.source)
            study.tell(pick, row(pick.source))


def test_a_study_loaded_again_goes_on_the_same(tmp_path):
    undisturbed = told(new(), 6)
    told(new(tmp_path), 3)
    resumed = told(mbtl.load_study(tmp_path), 3)
    assert [p.source for p in resumed.state.picks] == [p.source for p in undisturbed.state.picks]
    assert np.array_equal(resumed.curve, undisturbed.curve)


def test_the_budget_ends_the_study():
    study = told(new(budget=3), 3)
    assert study.is_finished
    with pytest.raises(StudyFinished, match="budget of 3 trainings is spent"):
        study.ask()


def test_a_level_ends_the_study_early():
    study = new(stop_value=0.8)
    with pytest.raises(StudyFinished, match=r"reaches the level 0\.8"):
        told(study, 6)
    assert len(study.state.picks) < 6


def test_a_cost_budget_ends_the_study_early():
    study = new(cost_budget=5.0)
    for _ in range(2):
        study.tell(study.ask(), row(9), cost=2.5)
    with pytest.raises(StudyFinished, match="cost 5 reaches the budget of 5"):
        study.ask()


def test_picks_asked_together_differ():
    study = new()
    picks = [study.ask() for _ in range(6)]
    assert len({pick.source for pick in picks}) == 6
    with pytest.raises(StudyFinished, match="6 picks are still under way"):
        study.ask()


def test_a_returned_pick_is_handed_out_again_before_a_new_one():
    study = new()
    first, second = study.ask(), study.ask()
    study.release(first)
    again = study.ask()
    assert (again.number, again.source) == (first.number, first.source)
    study.tell(second, row(second.source))
    study.tell(again, row(again.source))


def test_policies_a_user_already_has_are_free_and_are_used():
    study = new(budget=2)
    study.tell({"x": 0.0}, row(0))
    study.tell(19, row(19))
    assert (len(study.history), len(study.state.picks)) == (2, 0)
    pick = study.ask()
    assert pick.source not in (0, 19)


def test_telling_a_source_that_is_pending_answers_its_pick():
    study = new()
    pick = study.ask()
    study.tell(pick.source, row(pick.source))
    assert not study.state.open_picks
    with pytest.raises(StudyError, match="not open"):
        study.tell(pick, row(pick.source))
    with pytest.raises(StudyError, match="told before"):
        study.tell(pick.source, row(pick.source))


@pytest.mark.parametrize(
    ("returns", "words"),
    [
        (np.full(N, np.nan), "20 NaN or infinite"),
        (np.r_[np.zeros(N - 1), np.inf], "1 NaN or infinite"),
        (np.zeros(N + 1), r"shape \(20,\)"),
        (np.zeros((N, 2, 2)), "shape"),
        (np.zeros((N, 0)), "shape"),
        (["a"] * N, "numbers"),
        (None, "NaN"),
    ],
)
def test_unusable_returns_are_refused_and_the_pick_stays_open(returns, words):
    study = told(new(), 1)
    pick = study.ask()
    before = study.state.seq
    with pytest.raises(TrainingFailed, match=words if returns is not None else "shape|NaN"):
        study.tell(pick, returns)
    assert study.state.seq == before
    study.tell(pick, row(pick.source))
    assert len(study.history) == 2


def test_a_failure_is_recorded_spends_budget_and_is_not_proposed_again():
    study = new()
    pick = study.ask()
    study.fail(pick, "diverged")
    assert study.state.failures[0].reason == "diverged"
    told(study, 5)
    assert pick.source not in study.history.sources
    assert study.is_finished


def test_episodes_are_averaged_and_their_deviation_kept():
    study = new()
    pick = study.ask()
    study.tell(pick, row(pick.source)[:, None] + np.array([-0.1, 0.1]))
    record = study.state.rows[0]
    assert record.returns == pytest.approx(row(pick.source))
    assert record.std == pytest.approx(np.full(N, 0.1))
    assert record.episodes == 2


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
    for _ in range(6):
        pick = study.ask()
        study.tell(pick, 1000 * row(pick.source) * rng.uniform(0.1, 3))
    rows = np.array([r.returns for r in study.state.rows])
    assert (study.bounds.low, study.bounds.high) == (rows.min(), rows.max())
    again = mbtl.load_study(tmp_path)
    assert again.state.picks == study.state.picks


def test_a_stored_study_refuses_other_settings(tmp_path):
    new(tmp_path)
    for change in (
        {"budget": 5},
        {"seed": 1},
        {"selector": "greedy"},
        {"bounds": (0, 2)},
        {"problem": "x"},
    ):
        with pytest.raises(StudyMismatch, match="--new"):
            new(tmp_path, load_if_exists=True, **change)
    assert new(tmp_path, load_if_exists=True).spec.budget == 6
    with pytest.raises(StudyError, match="exists"):
        new(tmp_path)


def test_a_stored_study_refuses_another_space(tmp_path):
    new(tmp_path)
    other = mbtl.ContextSpace.grid({mbtl.Linear("y", 0.0, 1.0): N})
    with pytest.raises(StudyMismatch, match="space was ContextSpace"):
        mbtl.create_study(
            other, budget=6, bounds=(0, 1), storage=tmp_path / "study.db", load_if_exists=True
        )


class Last:
    """A user's own selector: the open context with the highest index."""

    name = "last"

    def propose(
        self, problem: SelectionProblem, history: History, rng: np.random.Generator
    ) -> Proposal:
        return Proposal(int(np.flatnonzero(history.open_mask(problem.n))[-1]), "highest index")


def test_a_users_own_selector_runs_and_is_asked_for_when_loading(tmp_path):
    study = told(new(tmp_path, selector=Last()), 3)
    assert [p.source for p in study.state.picks] == [19, 18, 17]
    with pytest.raises(StudyError, match="give it as selector="):
        mbtl.load_study(tmp_path)
    assert told(mbtl.load_study(tmp_path, selector=Last()), 1).state.picks[-1].source == 16


def test_settings_of_a_selector_are_part_of_the_study(tmp_path):
    new(tmp_path, selector=MBTL(warm_up=1))
    with pytest.raises(StudyMismatch, match="warm_up"):
        mbtl.load_study(tmp_path)
    assert mbtl.load_study(tmp_path, selector=MBTL(warm_up=1)).spec.budget == 6


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"budget": 0}, "budget must be from 1"),
        ({"budget": 21}, "budget must be from 1"),
        ({"selector": "mbtll"}, "Did you mean 'mbtl'"),
        ({"bounds": (1.0, 0.0)}, "low < high"),
        ({"direction": "up"}, "'maximize' or 'minimize'"),
        ({"theta": -1.0}, "theta"),
        ({"bounds": None, "stop_value": 0.5}, "needs bounds"),
        ({"cost_budget": 0.0}, "cost_budget"),
        ({"seed": -1}, ">= 0"),
    ],
)
def test_bad_settings_are_refused(change, words):
    with pytest.raises(InvalidInput, match=words):
        new(**change)


def test_a_context_outside_the_space_is_refused():
    with pytest.raises(InvalidInput, match=r"\[0, 1\]"):
        new().tell({"x": 1.5}, np.zeros(N))
    with pytest.raises(InvalidInput, match="0 to 19"):
        new().tell(20, np.zeros(N))


def test_two_studies_on_one_file_never_get_one_pick(tmp_path):
    new(tmp_path, budget=10)
    a, b = mbtl.load_study(tmp_path), mbtl.load_study(tmp_path)
    sources = [(a if k % 2 else b).ask().source for k in range(10)]
    assert len(set(sources)) == 10


def test_a_damaged_log_is_noticed(tmp_path):
    import sqlite3

    told(new(tmp_path), 3)
    with sqlite3.connect(tmp_path / "study.db") as connection:
        connection.execute("DELETE FROM mbtl_events WHERE seq = 3")
    connection.close()
    with pytest.raises(mbtl.MbtlError, match="event 3 is missing"):
        mbtl.load_study(tmp_path)
