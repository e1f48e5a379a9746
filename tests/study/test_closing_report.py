"""The closing report: how much it plays, on which contexts, and what a sample says of all."""

import numpy as np
import pytest
import scipy.stats

import mbtl
from flat import created, ran
from mbtl.report import summarise_study
from mbtl.report.text import fresh_episodes
from mbtl.seeds import Purpose
from mbtl.study.closing_report import chances, drawn, estimated, fresh_value, plan_of

N, TARGETS, EPISODES = 400, 20, 2
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): N})
X = SPACE.unit[:, 0]


def returns_of(policy, contexts, seeds):
    luck = [0.1 * np.random.default_rng(seed).standard_normal(EPISODES) for seed in seeds]
    return [1.0 - abs(policy - c["x"]) + one for c, one in zip(contexts, luck, strict=True)]


def study_of(**settings):
    settings = {"budget": 5, "bounds": (0.0, 1.0), "eval_targets": TARGETS, **settings}
    return created(SPACE, **settings)


def run(study, **wishes):
    """The result, and how many contexts each evaluation of the report had."""
    played = []

    def evaluate(policy, contexts, seeds):
        if seeds[0] >> 28 == Purpose.REPORT:
            played.append(len(contexts))
        return returns_of(policy, contexts, seeds)

    return study.run(lambda context, seed: context["x"], evaluate, **wishes), played


def test_a_report_costs_no_more_than_the_study_and_says_before_how_much(capsys):
    study = study_of()
    result, played = run(study, report=False)
    assert (result.fresh, played) == (None, [])
    assert result.value == study.value == study.routing.value.value
    result, played = run(study)
    assert result.value == study.value == result.fresh.value
    evaluations = sum(int(np.isfinite(row.returns).sum()) for row in study.state.rows)
    plan = plan_of(study.state)
    assert sum(played) == plan.evaluations <= evaluations < 5 * (TARGETS + 1) + 1
    assert result.fresh.contexts == len(plan.contexts) == evaluations // 2
    assert f"{plan.evaluations} evaluations of a policy on a context" in capsys.readouterr().err
    truth = 1.0 - np.abs(X - X[list(study.history.sources)][:, None])
    true = truth[plan.route, np.arange(N)].mean()
    assert abs(result.value - true) < result.fresh.margin < study.routing.value.margin
    assert not run(study)[1]  # it is done
    again, played = run(study, report="all")
    assert sum(played) == plan_of(study.state, whole=True).evaluations > evaluations
    assert again.fresh.contexts == N
    assert abs(again.value - true) < again.fresh.margin < result.fresh.margin
    assert not run(study, report="all")[1]


def told(n, rows, targets):
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): n})
    study = created(space, budget=rows, bounds=(0.0, 1.0))
    for source in np.linspace(0, n - 1, rows).astype(int).tolist():
        at = np.linspace(0, n - 1, targets).astype(int)
        study.tell(source, np.abs(at - source)[:, None] / -n * np.ones((1, 2)) + 1.0, targets=at)
    return plan_of(study.state)


@pytest.mark.parametrize(
    ("n", "rows", "targets", "contexts"),
    [
        (100, 2, 100, 100),  # up to 200 evaluations, if the study has made as many
        (400, 10, 20, 100),
        (400, 3, 10, 15),  # no more than the study has made
        (400, 3, 400, 150),  # a quarter of what it has made
        (400, 10, 400, 400),
        (400, 1, 30, 30),  # one policy is the best single one, too
    ],
)
def test_a_report_plays_a_quarter_of_what_the_study_did_or_200(n, rows, targets, contexts):
    plan = told(n, rows, targets)
    assert len(plan.contexts) == contexts
    assert plan.evaluations <= rows * targets
    assert plan.contexts.tolist() == told(n, rows, targets).contexts.tolist()


def test_contexts_are_drawn_as_their_weights_say():
    weights = np.array([0.0, 0.55, 0.05, 0.1, 0.1, 0.2])
    chance = chances(weights, 3)
    assert chance == pytest.approx([0.0, 1.0, 2 / 9, 4 / 9, 4 / 9, 8 / 9])
    rng = np.random.default_rng(0)
    count = np.zeros(6)
    for _ in range(3000):
        some = drawn(chance, rng)
        assert len(set(some.tolist())) == 3
        count[some] += 1
    assert count / 3000 == pytest.approx(chance, abs=0.03)
    assert chances(weights, 6).tolist() == [0.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    assert drawn(np.full(7, 1.0), rng).tolist() == list(range(7))


def test_a_sample_says_of_all_contexts_what_the_books_say():
    """By hand: simple random sampling of a finite population, without luck and with it."""
    rng = np.random.default_rng(0)
    weights, believed, errors = np.full(50, 0.02), rng.uniform(size=50), rng.standard_normal(50)
    played, some = np.full((50, 2), np.nan), rng.choice(50, 10, replace=False)
    played[some] = (believed + errors)[some, None]
    value, margin = estimated(believed, played, weights)
    assert value == pytest.approx(believed.mean() + errors[some].mean())
    variance = (1.0 - 10 / 50) * errors[some].var(ddof=1) / 10
    assert margin == pytest.approx(scipy.stats.t.ppf(0.975, 9) * np.sqrt(variance))
    played[some] += [[-0.5, 0.5]]  # 0.25 is the variance of each mean
    variance += 10 / 50 * 0.25 / 10
    assert estimated(believed, played, weights)[1] > 1.96 * np.sqrt(variance)
    assert estimated(believed, played, weights)[1] == pytest.approx(
        2.2 * np.sqrt(variance), rel=0.03
    )
    one = estimated(believed, played[:, :1], weights)[1]  # one episode: the whole spread counts
    off = scipy.stats.t.ppf(0.975, 9) * errors[some].std(ddof=1) / np.sqrt(10)
    assert one == pytest.approx(off)
    everything = np.tile(believed[:, None], 2)
    assert estimated(0.0 * believed, everything, weights) == (pytest.approx(believed.mean()), 0.0)
    assert estimated(believed, everything[:, :1], weights)[1] is None


def test_a_sample_by_weight_is_unbiased_and_its_intervals_cover():
    rng = np.random.default_rng(0)
    weights = rng.exponential(size=60) ** 2
    weights /= weights.sum()
    true = rng.standard_normal(60)
    believed = true + 0.3 * rng.standard_normal(60)
    chance, errors, inside = chances(weights, 25), [], []
    for _ in range(600):
        some, played = drawn(chance, rng), np.full((60, 3), np.nan)
        played[some] = true[some, None] + 0.2 * rng.standard_normal((25, 3))
        value, margin = estimated(believed, played, weights)
        errors.append(value - weights @ true)
        inside.append(abs(errors[-1]) < margin)
    assert abs(np.mean(errors)) < 3.0 * np.std(errors) / np.sqrt(600)
    assert 0.92 < np.mean(inside) < 0.98


def test_an_evaluation_of_the_report_has_the_time_limit_of_the_study(capsys):
    def evaluate(policy, contexts, seeds):
        while seeds[0] >> 28 == Purpose.REPORT:
            pass
        return returns_of(policy, contexts, seeds)

    study = study_of(budget=1)
    result = ran(study, lambda context, seed: 0.5, evaluate, timeout=0.5, progress=True)
    assert result.fresh is None
    assert result.value == study.routing.value.value
    assert (
        "could not be measured: TookTooLong: it took longer than 0.5 s" in capsys.readouterr().err
    )


def test_a_context_that_cannot_be_played_does_not_cost_the_fresh_v(capsys):
    def evaluate(policy, contexts, seeds):
        found = np.array(returns_of(policy, contexts, seeds))
        found[[context["x"] == 1.0 for context in contexts]] = np.nan
        return found

    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 20})
    study = created(space, budget=3, bounds=(0.0, 1.0))
    fresh = study.run(lambda context, seed: context["x"], evaluate).fresh
    assert fresh.contexts == 19
    assert abs(fresh.value - study.routing.value.value) < 0.1
    alone = created(
        mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 4}), budget=4, bounds=(0.0, 1.0),
        strategy="random",
    )  # fmt: skip
    assert alone.run(lambda context, seed: context["x"], evaluate).fresh.contexts == 3
    told = capsys.readouterr().err
    assert "1 of 20 contexts had no fresh episode that counts: of these V is as believed" in told


def test_an_episode_that_gives_none_is_nan_in_the_log_and_not_counted():
    """The mean of its context's others stood there, and was said to be an episode."""

    def evaluate(policy, contexts, seeds):
        found = np.array(returns_of(policy, contexts, seeds))
        found[[context["x"] == 1.0 for context in contexts], 0] = np.nan
        return found

    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 4})
    study = created(space, budget=2, bounds=(0.0, 1.0))
    fresh = study.run(lambda context, seed: context["x"], evaluate).fresh
    (event,) = [one for one in study.log.read() if one.kind == "reported"]
    assert np.argwhere(np.isnan(event.arrays["served"])).tolist() == [[3, 0]]
    assert fresh.served == pytest.approx(np.nanmean(event.arrays["served"], axis=1))
    said = fresh_episodes(summarise_study(study))
    assert said == f"{EPISODES - 1} to {EPISODES} fresh episodes per context, which chose nothing"


def test_a_region_that_never_plays_is_no_sample_of_the_others():
    def evaluate(policy, contexts, seeds):
        found = np.array(returns_of(policy, contexts, seeds))
        found[[context["x"] > 0.7 for context in contexts]] = np.nan
        return found

    space, playing = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 20}), []
    study = created(space, budget=3, bounds=(0.0, 1.0))

    def counted(policy, contexts, seeds):
        playing.extend(contexts)
        return evaluate(policy, contexts, seeds)

    fresh = study.run(lambda context, seed: context["x"], counted).fresh
    x, sources = space.unit[:, 0], list(study.history.sources)
    true = (1.0 - np.abs(x - x[sources][:, None]))[study.routing.route, np.arange(20)].mean()
    noise = 0.1 / np.sqrt(20 * EPISODES)
    assert abs(fresh.value - true) < fresh.margin
    assert fresh.margin > 3.0 * noise  # what is believed of the region has its doubt
    assert fresh.gain_margin > 2.5 * noise
    said = fresh_episodes(summarise_study(study))
    assert "each of 14 of the 20 contexts (6 more gave none)" in said
    assert said.endswith("contexts that gave none count as estimated")
    playing.clear()
    study.run(lambda context, seed: context["x"], counted, report="all")
    assert playing == []  # they were tried


def test_a_gain_has_the_doubt_of_where_the_best_single_policy_cannot_play():
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 20})
    x = space.unit[:, 0]
    study = created(space, budget=2, bounds=(0.0, 1.0), strategy="random")
    for home in (4, 15):
        study.tell(home, np.where(np.abs(x - x[home]) < 0.6, 1.0 - np.abs(x - x[home]), np.nan))
    route, best = study.routing.route, study.routing.best_single
    rows = 1.0 - np.abs(x - x[list(study.history.sources)][:, None])
    served, alone = rows[route, np.arange(20)], rows[best].copy()
    true = (served - alone).mean()
    alone[np.abs(x - x[study.history.sources[best]]) >= 0.6] = np.nan
    study.record_fresh_returns(*(each[:, None] for each in (served, alone)), best_single=best)
    fresh = fresh_value(study.state)
    assert fresh.contexts == 20
    assert fresh.value == pytest.approx(served.mean())
    assert abs(fresh.gain - true) < 0.05
    study.record_fresh_returns(
        *(each[:, None] + np.zeros(2) for each in (served, alone)), best_single=best
    )
    fresh = fresh_value(study.state)
    assert fresh.gain_margin > 0.02


def test_a_callback_that_fails_ends_the_run_also_at_the_report():
    class Failing(mbtl.Callback):
        def on_report(self, study, plan):
            raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        run(study_of(budget=1), callbacks=[Failing()])
    for wrong in (Failing(), [Failing]):
        with pytest.raises(mbtl.InvalidInput, match=r"a list of objects, as \[MyCallback\(\)\]"):
            run(study_of(budget=1), callbacks=wrong)


def test_policies_that_were_told_without_files_are_said_to_miss(capsys):
    study = study_of(budget=1)
    study.tell(200, 1.0 - np.abs(X - X[200]))
    run(study)
    assert "could not be measured: policies that serve were told without their files" in (
        capsys.readouterr().err
    )


def test_the_worst_contexts_are_not_chosen_by_the_bad_luck_of_a_report():
    result, played = run(study_of(risk=0.1))
    assert result.fresh is None
    assert not played
