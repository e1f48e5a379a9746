"""Studies from flat keywords: what a test varies, without the records around it; and told ones."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import mbtl
from mbtl.contexts import ContextSpace
from mbtl.study.problem import ProblemFacts, facts_of
from mbtl.trainers import FunctionTrainer

_AIM = ("bounds", "direction", "risk", "best_return")
_END = {"stop_value": "value", "stop_left": "left", "stop_confidence": "confidence"}
_RUN = ("parallel", "executor", "lease", "timeout")
_FAIL = {
    "stop_after_failures": "most_in_a_row", "retries": "retries", "retry_failed": "retry_failed",
    "rehearse": "rehearse",
}  # fmt: skip


@dataclass(frozen=True)
class Bare:
    """Contexts, and what else a problem may say."""

    given: ProblemFacts

    def facts(self, preset=None, trainer=None) -> ProblemFacts:
        return self.given if trainer is None else replace(self.given, trainer=trainer)


def created(problem: Any, /, **given: Any) -> mbtl.Study:
    """`mbtl.create_study` where bounds, stopping rules, costs, trainer, ... are keywords.

    Contexts are chosen, unless a strategy is given that chooses trainings of every kind.
    """
    aim = {name: given.pop(name) for name in _AIM if name in given}
    end = {name: given.pop(key) for key, name in _END.items() if key in given}
    facts = {
        key: given.pop(key) for key in ("trainer", "theta", "trial", "settings") if key in given
    }
    if "problem" in given:
        facts["id"] = given.pop("problem")
    if facts and isinstance(problem, ContextSpace):
        problem = Bare(replace(facts_of(problem), **facts))
    elif facts or "preset" in given:
        problem = problem.recipe(given.pop("preset", None), **facts)
    if "eval_targets" in given:
        given["evaluation"] = mbtl.Evaluation(given.pop("eval_targets"))
    if (total := given.pop("cost_budget", None)) is not None:
        given["budget"] = mbtl.Cost(total, given.pop("costs", None), given.get("budget"))
    if aim:
        given["objective"] = mbtl.Objective(**aim)
    if end:
        given["stopping"] = mbtl.Stopping(**{k: v for k, v in end.items() if v is not None})
    return mbtl.create_study(problem, **{"strategy": "specialists", **given})


def told(study: mbtl.Study, returns: Any, picks: int = 1, **facts: Any) -> mbtl.Study:
    """The study after so many picks, which got `returns(source)` of their targets."""
    for _ in range(picks):
        pick = study.ask()
        row = returns(pick.source)
        study.tell(pick, row if pick.targets is None else row[list(pick.targets)], **facts)
    return study


def ran(study: mbtl.Study, train: Any = None, evaluate: Any = None, **given: Any) -> Any:
    """`Study.run` where options are keywords; with `threads`, that many at once; without a line."""
    if threads := given.pop("threads", None):
        with ThreadPoolExecutor(2) as pool:
            return ran(study, train, evaluate, parallel=threads, executor=pool, **given)
    workers = {name: given.pop(name) for name in _RUN if name in given}
    failures = {name: given.pop(key) for key, name in _FAIL.items() if key in given}
    if given.pop("on_failure", "continue") == "stop":
        failures["most_in_a_row"] = 1
    save, load = given.pop("save", None), given.pop("load", None)
    if save is not None or load is not None:
        given["trainer"] = FunctionTrainer(train, evaluate, save, load)
        train = evaluate = None
    if given.pop("accept_changes", False):
        trainer = given.get("trainer") or (FunctionTrainer(train, evaluate) if train else None)
        study.equip(trainer or study.trainer, accept_changes=True)
    if workers:
        given["workers"] = mbtl.Workers(**workers)
    if failures:
        given["failures"] = mbtl.Failures(**failures)
    return study.run(train, evaluate, **{"progress": False, **given})
