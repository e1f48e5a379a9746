"""What V is compared with, and what is measured beside it, in the same fresh episodes."""

import dataclasses

import numpy as np
import pytest
from line_problem import load, save

import mbtl
from mbtl.errors import UnknownName
from mbtl.report import of_study, summarise_study
from mbtl.report.content import content
from mbtl.report.text import lines
from mbtl.trainers import FunctionTrainer

SPACE = mbtl.ContextSpace.grid({mbtl.Linear("demand", 1.0, 5.0, unit="veh/min"): 5})
DELAY = mbtl.Score("delay", unit="s/veh", direction="minimize")


def train(context, seed):
    return context["demand"]


def evaluate(policy, contexts, seeds):
    """A policy delays cars by 10 s, and 2 s more per step from its home; "fixed" by 14 s."""
    luck = np.array([np.random.default_rng(seed).normal(0.0, 0.1, 3) for seed in seeds])
    asked = np.array([context["demand"] for context in contexts])[:, None]
    delay = np.full_like(asked, 14.0) if policy == "fixed" else 10.0 + 2.0 * abs(asked - policy)
    return {"delay": delay + luck, "throughput": 60.0 * asked + 0.0 * luck}


def problem(**record):
    return mbtl.CMDP.from_functions(
        "light", SPACE, train=train, evaluate=evaluate, save=save, load=load, score=DELAY,
        bounds=(10.0, 30.0), metrics={"throughput": "veh/h"}, **record,
    )  # fmt: skip


def ran(budget, baselines=("fixed",), storage=None):
    given = dict(zip(("fixed time", "slow"), baselines, strict=False))
    cmdp = problem(baselines=given)
    study = mbtl.create_study(cmdp, budget=budget, strategy="equidistant", storage=storage)
    study.run(progress=False)
    return study


def compared(study, baselines):
    """Its policies delay cars by 14 s in fresh episodes."""
    fresh = np.full((5, 3), 14.0)
    study.record_fresh_returns(fresh, fresh, best_single=0, baselines=baselines)


def test_a_context_that_nobody_can_play_does_not_cost_the_comparison():
    def broken(policy, contexts, seeds):
        told = evaluate(policy, contexts, seeds)
        told["delay"][[context["demand"] == 5.0 for context in contexts]] = np.nan
        return told

    cmdp = problem(baselines={"fixed time": "fixed"})
    study = mbtl.create_study(cmdp, budget=2, strategy="equidistant")
    study.run(trainer=dataclasses.replace(cmdp.trainer, evaluate_fn=broken), progress=False)
    summary = summarise_study(study)
    (fixed,) = summary.baselines
    assert summary.fresh_lost == 1
    assert fixed.lead == pytest.approx(0.1, abs=0.05)
    assert fixed.lead_margin > 0.01  # nobody knows of the fifth


def test_a_baseline_that_breaks_where_policies_do_not_is_not_compared(capsys):
    def broken(policy, contexts, seeds):
        told = evaluate(policy, contexts, seeds)
        if policy == "fixed":
            told["delay"][[context["demand"] > 3.0 for context in contexts]] = np.nan
        return told

    cmdp = problem(baselines={"fixed time": "fixed"})
    study = mbtl.create_study(cmdp, budget=2, strategy="equidistant")
    study.run(trainer=dataclasses.replace(cmdp.trainer, evaluate_fn=broken))
    assert summarise_study(study).baselines == ()
    assert "'fixed time' could not be compared: TrainingFailed: each context needs" in (
        capsys.readouterr().err
    )


def test_the_score_has_a_direction_and_is_what_a_mapping_is_read_for():
    cmdp = problem()
    assert cmdp.direction == "minimize"
    row = cmdp.trainer.evaluate(3.0, [{"demand": 3.0}], [0])
    assert row.shape == (1, 3)
    assert row == pytest.approx(10.0, abs=0.5)


def test_the_first_line_says_whether_training_is_worth_it():
    study = ran(2)
    summary = summarise_study(study)
    (fixed,) = summary.baselines
    assert fixed.value == pytest.approx(0.8, abs=0.01)  # 14 s between 30 and 10
    assert fixed.lead == pytest.approx(study.value - fixed.value)
    assert 0.0 < fixed.lead_margin < 0.02
    first, *rest = lines(summary, SPACE)
    assert first.startswith("Training is worth it: 0.")
    assert "ahead of 'fixed time' (V 0.80" in first
    assert "mean delay 1" in first
    assert "s/veh" in first
    assert any(line.startswith("policies: V ") and "throughput 180 veh/h" in line for line in rest)
    assert any(line.startswith("fixed time: V 0.80") for line in rest)


class WithRandomActions(FunctionTrainer):
    """Its system can do that by itself: 20 s everywhere."""

    def ways(self, contexts):
        return ("random_actions",)

    def measure(self, policy, contexts, seeds, names):
        if policy == "random_actions":
            return {"score": np.full((len(contexts), 3), 20.0)}
        return super().measure(policy, contexts, seeds, names)


@pytest.mark.parametrize(("baselines", "compared"), [({}, "random actions"), ({"old": 1.0}, "old")])
def test_random_actions_stand_in_where_there_is_nothing_else(baselines, compared):
    trainer = WithRandomActions(train, evaluate, save, load, score="delay")
    study = mbtl.create_study(
        dataclasses.replace(problem(baselines=baselines), trainer=trainer), budget=1,
        strategy="equidistant",
    )  # fmt: skip
    study.run(progress=False)
    (one,) = summarise_study(study).baselines
    assert one.name == compared
    if compared == "random actions":
        assert one.value == pytest.approx(0.5)  # 20 s between 30 and 10
        assert lines(summarise_study(study), SPACE)[0].startswith("Training is worth it: 0.")


@pytest.mark.parametrize("own", [{}, {"mine": "random_actions"}])
def test_a_baseline_that_fails_cannot_cost_the_fresh_v(own, capsys):
    class Diverging(WithRandomActions):
        ill = True

        def measure(self, policy, contexts, seeds, names):
            if self.ill and policy == "random_actions":
                raise RuntimeError("the simulator diverged")
            return super().measure(policy, contexts, seeds, names)

    trainer = Diverging(train, evaluate, save, load, score="delay")
    cmdp = dataclasses.replace(problem(baselines=own), trainer=trainer)
    study = mbtl.create_study(cmdp, budget=1, strategy="equidistant")
    assert study.run().fresh is not None
    name = "mine" if own else "random actions"
    assert f"{name!r} could not be compared: RuntimeError" in capsys.readouterr().err
    assert not summarise_study(study).baselines
    Diverging.ill = False
    study.run(progress=False)  # once it is mended
    assert [one.name for one in summarise_study(study).baselines] == [*own]


def test_a_baseline_that_the_system_does_not_know_is_refused_before_any_training():
    trainer = WithRandomActions(train, evaluate, save, load, score="delay")
    cmdp = dataclasses.replace(problem(baselines={"mine": "random_action"}), trainer=trainer)
    study = mbtl.create_study(cmdp, budget=1, strategy="equidistant")
    with pytest.raises(UnknownName, match="Did you mean 'random_actions'"):
        study.run(progress=False)
    assert not study.state.picks


def test_the_page_speaks_the_unit_of_the_score_context_by_context():
    subject = of_study(ran(2))
    assert list(subject.columns) == [
        "delay [s/veh]",
        "throughput [veh/h]",
        "fixed time: delay [s/veh]",
    ]
    np.testing.assert_allclose(subject.columns["fixed time: delay [s/veh]"], 14.0, atol=0.5)
    assert "mean delay 1" in " ".join(subject.headline)
    assert subject.levels["fixed time"] == pytest.approx(0.8, abs=0.01)  # a line beside the curve
    heads, policies, fixed = subject.beside
    assert heads == ["", "V", "delay [s/veh]", "throughput [veh/h]"]
    assert policies[0] == "policies"
    assert fixed[0] == "fixed time"
    assert float(fixed[2]) == pytest.approx(14.0, abs=0.5)
    np.testing.assert_allclose(subject.served, summarise_study(ran(2)).served)
    assert content(subject)["columns"]["throughput [veh/h]"].tolist() == [60, 120, 180, 240, 300]


def test_a_baseline_that_is_as_good_or_better_is_said_first():
    study = ran(1)
    compared(study, {"fixed time": np.full((5, 3), 13.0)})
    first = lines(summarise_study(study), SPACE)[0]
    assert first.startswith("Training is not worth it so far: 0.0500 behind 'fixed time'")
    spread = np.array([13.0, 14.0, 15.0])
    compared(study, {"fixed time": np.tile(spread, (5, 1))})
    assert lines(summarise_study(study), SPACE)[0].startswith("Training adds nothing sure to")


def test_contexts_where_a_baseline_did_better_are_named():
    study = ran(1)
    better = np.array([13.0, 15.0, 12.0, 14.5, 14.0])[:, None] + np.zeros((5, 3))
    compared(study, {"slow": np.full((5, 3), 20.0), "fixed time": better})
    summary = summarise_study(study)
    assert summary.behind == ((2, "fixed time"), (0, "fixed time"))
    said = "A baseline did better in 2 of 5 contexts, most at demand = 3 veh/min (fixed time)."
    assert said in lines(summary, SPACE)


def test_baselines_and_metrics_are_kept_in_the_log_and_new_ones_are_played_later(tmp_path):
    ran(2, storage=tmp_path / "study.db")
    again = mbtl.load_study(tmp_path / "study.db")
    fresh = again.state.fresh
    cars = fresh.metrics["fixed time"]["throughput"]
    np.testing.assert_allclose(cars, [60.0, 120.0, 180.0, 240.0, 300.0])
    assert fresh.units == {"throughput": "veh/h"}
    events = again.state.seq
    for given, more in ({"fixed time": "fixed"}, 0), ({"fixed time": "fixed", "far": 5.0}, 1):
        cmdp = problem(baselines=given)
        mbtl.load_study(tmp_path / "study.db", problem=cmdp).run(progress=False)
        assert again.refresh().seq == events + more
    assert [*again.state.fresh.baselines] == ["fixed time", "far"]


def test_a_metric_that_no_episode_tells_is_named(capsys):
    cmdp = dataclasses.replace(problem(), metrics={"troughput": "veh/h"})
    study = mbtl.create_study(cmdp, budget=1, strategy="equidistant")
    study.run()
    assert "no episode told the metrics troughput" in capsys.readouterr().err
    assert summarise_study(study).metrics == {}


def test_the_best_of_several_baselines_counts():
    summary = summarise_study(ran(2, baselines=("fixed", 5.0)))
    assert [one.name for one in summary.baselines] == ["fixed time", "slow"]
    assert "'fixed time' (V" in lines(summary, SPACE)[0]


def test_a_mapping_without_the_score_is_refused_with_the_fix():
    trainer = FunctionTrainer(train, evaluate)
    with pytest.raises(mbtl.TrainingFailed, match=r"name it, score=mbtl.Score"):
        trainer.evaluate(1.0, [{"demand": 1.0}], [0])
    with pytest.raises(mbtl.InvalidInput, match="direction"):
        mbtl.CMDP.from_functions(
            "x", SPACE, train=train, evaluate=evaluate, score=mbtl.Score("delay", direction="down")
        )
