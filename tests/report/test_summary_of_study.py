import io
import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from rich.console import Console

import mbtl
from flat import created, told
from mbtl.problems import get_cmdp
from mbtl.report import of_study, page, reference_curves, summarise_study
from mbtl.report.content import content
from mbtl.report.summary import policies_enough
from mbtl.report.text import beside_table, lines, show_summary
from mbtl.selectors import Proposal, Traits
from mbtl.study.closing_report import plan_of
from mbtl.study.problem import Beside
from mbtl.study.study import PrintProgress

N = 20
SPACE = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0, unit="m"): N})


def row(source):
    return 0.9 - 0.02 * np.abs(source - np.arange(N))


def study_of(picks, episodes=1, **settings):
    study = created(SPACE, budget=6, bounds=(0.0, 1.0), problem="toy", strategy="mbtl", **settings)
    return told(study, lambda source: np.repeat(row(source)[:, None], episodes, axis=1), picks)


def test_numbers_of_a_known_study():
    summary = summarise_study(study_of(4))
    assert [p.source for p in summary.picks] == [9, 19, 0, 14]
    assert summary.value == pytest.approx(np.max([row(s) for s in (9, 19, 0, 14)], axis=0).mean())
    assert summary.best_single == 0
    assert summary.best_single_value == pytest.approx(row(9).mean())
    assert summary.serving == tuple([2] * 5 + [0] * 7 + [3] * 5 + [1] * 3)
    assert summary.finished is None
    summary = summarise_study(study_of(2))  # at 9 and 19: context 0 is farthest from both
    assert (summary.worst_context, summary.worst_context_value) == (0, pytest.approx(0.72))
    assert "; the worst context, x = 0 m, at 0.7200." in " ".join(lines(summary, SPACE))


def test_fresh_episodes_are_the_headline_when_measured():
    study = study_of(4)
    before = study.value
    served = study.routing.served[:, None] - 0.1
    study.record_fresh_returns(served, served - 0.2, best_single=0)
    summary = summarise_study(study)
    assert summary.fresh_value == study.value == pytest.approx(before - 0.1)
    assert summary.value == before  # still there, as what it is
    assert (summary.single_gain, summary.best_single_value) == pytest.approx((0.2, before - 0.3))
    said = " ".join(lines(summary, SPACE))
    assert f"V = {study.value:.4f} (one episode each, so its error is unknown) on" in said
    assert "estimated" not in said  # one V is said


def test_what_is_served_worst_is_chosen_by_other_episodes_than_those_that_say_how_badly():
    study = study_of(2)  # at 9 and 19: context 0 is believed to be worst
    served = study.routing.served[:, None].copy()
    served[5] = 0.1  # bad luck, or unknown before
    study.record_fresh_returns(served, served, best_single=0)
    summary = summarise_study(study)
    assert (summary.worst_context, summary.worst_context_value) == (0, pytest.approx(0.72))
    assert summary.worst_tenth == pytest.approx((0.72 + 0.74) / 2)
    assert summary.served[5] == 0.1
    said = " ".join(lines(summary, SPACE))
    assert (
        "Of the contexts, the tenth that seemed worst before the fresh episodes is at 0.7300; "
        "x = 0 m, which seemed worst of all, is at 0.7200."
    ) in said


def test_worst_contexts_and_metrics_are_of_contexts_that_were_played():
    """The metric is the score, and V is of all contexts: one line says of which each number is."""
    study = study_of(2)
    study.beside = Beside(metrics={"same": "m"})
    served = study.routing.served[:, None].copy()
    served[:4] = np.nan  # those believed to be worst, and two more
    study.record_fresh_returns(
        served, served, best_single=0, lost=range(4),
        baselines={"edge": served}, metrics=np.array([served.T, served.T]),
    )  # fmt: skip
    summary, played = summarise_study(study), np.sort(served[4:, 0])
    assert summary.worst_context == 4
    assert summary.worst_tenth == pytest.approx((played[0] + 0.6 * played[1]) / 1.6)
    said = lines(summary, SPACE)
    assert any("Of the contexts played, the tenth that seemed worst" in line for line in said)
    mean = f"mean return {summary.fresh_value:.4g}, mean of the 16 contexts played: same"
    assert f"policies: V {summary.fresh_value:.4f}, {mean} {played.mean():.4g} m" in said
    assert beside_table(summary)[0] == ["", "V", "return", "same [m], 16 contexts"]
    worst = re.search(r"<h2>Served worst</h2>.*?</section>", page([of_study(study)]), re.DOTALL)[0]
    assert "x = 0 m" not in worst
    assert "<td>–</td>" not in worst


def test_a_metric_counts_a_context_drawn_by_its_weight_for_no_more_than_the_others():
    weights = np.arange(1.0, N + 1.0)
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): N}, weights=weights)
    study = told(created(space, budget=2, bounds=(0.0, 1.0), strategy="mbtl"), row, 2)
    study.beside = Beside(metrics={"same": ""})
    served = np.full((N, 1), np.nan)
    served[[3, 9, 18], 0] = 0.3, 0.6, 0.9
    study.record_fresh_returns(served, served, best_single=0, metrics=served.T[None])
    assert summarise_study(study).metrics["policies"]["same"] == pytest.approx(0.6)


def test_a_context_where_no_policy_that_serves_was_evaluated_is_not_named_as_the_worst():
    study = created(SPACE, budget=2, bounds=(0.0, 1.0), eval_targets=5, strategy="mbtl")
    pick = study.ask()
    study.tell(pick, row(pick.source)[list(pick.targets)])
    summary = summarise_study(study)
    assert summary.worst_context in pick.targets
    assert "The worst-served tenth of the contexts played is" in " ".join(lines(summary, SPACE))


def test_contexts_without_weight_are_not_the_worst():
    weights = np.array([0.0, 0.0, *[1.0] * (N - 2)])
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): N}, weights=weights)
    study = told(created(space, budget=2, bounds=(0.0, 1.0), strategy="mbtl"), row, 2)
    assert summarise_study(study).worst_context == 2


def test_with_a_risk_v_is_said_to_be_of_the_worst_contexts():
    study = study_of(2, risk=0.1, episodes=3)
    said = " ".join(lines(summarise_study(study), SPACE))
    assert "the mean over the worst 10% of the contexts, estimated" in said
    assert "Served worst, as far as is known: x = 0 m, at 0.7200." in said
    assert "worst-served tenth" not in said
    assert "evaluate on more targets" not in said
    study = created(SPACE, budget=2, bounds=(0.0, 1.0), eval_targets=5, strategy="mbtl", risk=0.1)
    pick = study.ask()
    study.tell(pick, row(pick.source)[list(pick.targets)])
    said = " ".join(lines(summarise_study(study), SPACE))
    assert "worst may be far worse than predicted: evaluate on more targets" in said


def test_fresh_intervals_are_of_independent_contexts_and_paired_between_policies():
    """By hand: two episodes of every context, whose luck both policies share."""
    study = study_of(2, episodes=2)
    luck = np.random.default_rng(0).standard_normal((N, 2))
    study.record_fresh_returns(0.8 + 0.1 * luck, 0.7 + 0.1 * luck, best_single=1)
    summary = summarise_study(study)
    variances = (0.1 * luck).var(axis=1, ddof=1) / 2 / N**2
    freedom = 3 * variances.sum() ** 2 / (variances**2).sum() - 2
    assert 4 < freedom < N
    assert summary.fresh_margin == pytest.approx(
        scipy.stats.t.ppf(0.975, freedom) * variances.sum() ** 0.5
    )
    assert summary.single_gain == pytest.approx(0.1)
    assert summary.single_gain_margin == pytest.approx(0.0, abs=1e-9)


def test_it_is_said_on_how_many_contexts_and_in_how_many_episodes_policies_were_evaluated():
    study = created(SPACE, budget=4, bounds=(0.0, 1.0), eval_targets=5)
    study.tell(study.ask(), np.full((5, 3), 0.5))
    first = lines(summarise_study(study), SPACE)[0]
    assert first.endswith("Every policy was evaluated on 5 of 20 contexts in 3 episodes.")
    study.tell(study.ask(), np.full((20, 2), 0.5), targets=range(20))
    first = lines(summarise_study(study), SPACE)[0]
    assert first.endswith("Policies were evaluated on 5 to 20 of 20 contexts in 2 to 3 episodes.")


def test_policies_that_are_the_same_are_said_to_be():
    study = study_of(2, episodes=2)
    study.tell(5, np.full((N, 2), 0.3))
    study.tell(7, np.full((N, 2), 0.3))
    summary = summarise_study(study)
    assert summary.alike == ((2, 3),)
    assert "Policies 3 and 4 returned the same in every episode" in " ".join(lines(summary, SPACE))


@pytest.mark.parametrize(
    ("gain", "margin", "verdict"),
    [
        (0.0010, 0.0046, "One policy is enough here: "),
        (0.0099, 0.0046, "Several policies are better than one, if not by much: "),
        (0.0030, 0.0080, "Whether one policy is enough cannot be said yet: "),
        (0.0500, 0.0080, "One policy is not enough: "),
    ],
)
def test_the_verdict_follows_from_the_interval(gain, margin, verdict):
    summary = replace(summarise_study(study_of(3)), single_gain=gain, single_gain_margin=margin)
    assert summary.verdict.startswith(verdict)


def test_the_verdict_names_the_context_where_other_policies_are_missed_most():
    study = created(SPACE, budget=3, bounds=(0.0, 1.0))
    best, other = np.full((N, 2), 0.6), np.full((N, 2), 0.1)
    other[15:] = [[0.7], [0.8], [0.9], [1.0], [0.8]]
    study.tell(5, best)
    study.tell(18, other)
    verdict = summarise_study(study).verdict
    where = SPACE.describe(SPACE.context(18))
    assert f"Others serve 5 of {N} contexts; without them most is lost at {where}." in verdict


def test_verdict_is_silent_where_chance_decides():
    assert "cannot be said from one episode" in summarise_study(study_of(4)).verdict
    rng = np.random.default_rng(0)
    noisy = created(SPACE, budget=3, bounds=(0.0, 1.0), strategy="mbtl")
    told(noisy, lambda source: 0.8 + 0.3 * rng.standard_normal((N, 3)), 3)
    summary = summarise_study(noisy)
    assert summary.verdict.startswith("Whether one policy is enough cannot be said yet")
    assert summary.single_gain_margin > 0.01


def test_fewest_policies_for_nearly_all_the_gain():
    rows = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.9, 0.9, 0.9]])
    weights = np.full(3, 1 / 3)
    assert len(policies_enough(rows[3:], weights)) == 1
    assert sorted(policies_enough(rows[:3], weights)) == [0, 1, 2]
    assert policies_enough(np.array([[0.5, 0.5], [0.5, 0.5]]), np.full(2, 0.5)) == (0,)


def test_reference_curves_need_the_same_recipe(tmp_path, monkeypatch):
    from mbtl.zoo.benchmark import TransferMatrix, save_shipped, shipped

    rng = np.random.default_rng(0)
    returns = np.array([[row(s) for s in range(N)]] * 2) + 0.01 * rng.standard_normal((2, N, N))
    seeds = {"seeds": [{"recipe": {"timesteps": 5}}] * 2}
    matrix = TransferMatrix.of(returns, space=SPACE, bounds=(0, 1), provenance=seeds)
    save_shipped(matrix, tmp_path, "toy")
    monkeypatch.setattr(
        "mbtl.zoo.benchmark.subject.shipped_matrices", lambda: shipped.shipped_matrices(tmp_path)
    )
    monkeypatch.setattr(
        "mbtl.zoo.benchmark.subject.load_matrix",
        lambda name: shipped.load_matrix(name, folder=tmp_path),
    )
    assert reference_curves(study_of(1)) is None
    assert reference_curves(study_of(1, settings={"recipe": {"timesteps": 6}})) is None
    same = reference_curves(study_of(1, settings={"recipe": {"timesteps": 5}}))
    assert list(same.baselines) == ["Random", "Greedy", "Sequential Oracle"]
    assert {curves.shape for curves in same.baselines.values()} == {(2, 6)}
    assert (same.baselines["Sequential Oracle"] >= same.baselines["Random"]).all()
    grand_mean = returns.mean()
    assert f"random policy {grand_mean:.4f}." in same.said


def test_report_portfolio_and_fresh_episodes_follow_the_same_routes_also_where_policies_tie():
    """Two policies that are equally good in the episodes seen; afresh each is good near its own."""
    study = created(SPACE, budget=2, bounds=(0.0, 1.0), strategy="mbtl")
    portfolio = told(study, lambda source: np.full((N, 2), 0.9), 2).portfolio()
    nearest = np.abs(np.arange(N)[:, None] - study.history.sources).argmin(axis=1)
    assert portfolio.routing.route.tolist() == nearest.tolist()
    plan = plan_of(study.state)
    assert plan.route.tolist() == nearest.tolist()
    assert summarise_study(study).serving == tuple(nearest)
    for k in (1, 2):  # and so for every prefix
        assert study.routing.after(k).route.max() < k


class InTurn:
    """Asks for these trainings, one after the other."""

    name, traits = "in turn", Traits(any_training=True)

    def __init__(self, script):
        self.script = iter(script)

    def propose(self, problem, history, rng):
        return next(self.script)


def test_a_training_is_said_by_its_contexts_what_it_began_with_and_how_long_it_was():
    everyone = tuple(range(N))
    script = (
        Proposal(9, "all", length=1.0, sources=everyone, targets=(0, 9, 19)),
        Proposal(9, "longer", start=0, length=2.0, sources=everyone),
        Proposal(5, "tuned", start=1, length=0.5),
        Proposal(9, "further", start=0, length=0.0, sources=everyone, targets=(4, 5)),
        Proposal(7, "some", sources=(6, 7, 8)),
        Proposal(0, "alone"),
    )
    study = created(SPACE, budget=6, bounds=(0.0, 1.0), strategy=InTurn(script))
    levels = iter((0.3, 0.5, 0.6, 0.3, 0.4))
    told(study, lambda source: np.full(N, next(levels)), 5)
    study.fail(study.ask(), "diverged")
    summary = summarise_study(study)
    assert [(pick.trained_on(SPACE), pick.status) for pick in summary.picks] == [
        ("all contexts", "told"),
        ("all contexts, 1 to 2 units", "told"),
        ("x = 0.2632 m, tuned from training 2, 0.5 units", "told"),
        ("3 contexts", "told"),
        ("all contexts, training 1 evaluated further", "evaluated"),
        ("x = 0 m", "failed: diverged"),
    ]
    assert study.state.units().tolist() == [1.0, 2.0, 2.5, 3.5]
    assert summary.spent == "4.5 of 6 units"
    assert "Spent: 4.5 of 6 units." in lines(summary, SPACE)
    assert (summary.best_single, set(summary.serving)) == (2, {2})
    subject = of_study(study)
    shown = content(subject)
    assert shown["trained"][1] == "all contexts, 1 to 2 units"
    assert shown["curve"]["units"] == [1.0, 2.0, 2.5, 3.5]
    assert "<td>x = 0.2632 m, tuned from training 2, 0.5 units</td>" in page([subject])
    said = io.StringIO()
    PrintProgress(said).on_told(study, study.pick(1))
    assert said.getvalue().startswith("pick 2, 4.5 of 6 units: all contexts, 1 to 2 units, V = ")


def test_a_context_of_three_axes_takes_three_lines_of_the_table():
    space = get_cmdp("cartpole-masses-length").space
    study = created(space, budget=2, bounds=(0.0, 1.0), problem="cartpole-masses-length")
    study.tell(study.ask(), np.linspace(0.1, 0.9, space.n))
    screen = Console(file=io.StringIO(), width=80)
    show_summary(screen, summarise_study(study), space)
    text = screen.file.getvalue()
    assert "\N{HORIZONTAL ELLIPSIS}" not in text, "nothing is cut off"
    first = next(line for line in text.splitlines() if "masspole = 0.1 kg" in line)
    assert first.split()[5] == "0.5000", "V beside the first axis"
    assert "masscart" not in first
