"""Workers of a study that is paid in steps: `mbtl worker`, and the master that follows them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from mbtl.cli.common import console, print_json
from mbtl.cli.step_progress import StepProgress
from mbtl.cmdps import CMDP
from mbtl.errors import InvalidInput, StudyError
from mbtl.settings import described, first_difference
from mbtl.study import SqlLog
from mbtl.study.described import describe_selector, without_origin
from mbtl.study.listing import chosen_name, database_at, is_paid_in_steps
from mbtl.study.steps.study import StepStudy
from mbtl.study.steps.summary import counted

_LOOK, _LONGEST_LOOK = 0.1, 2.0
"""Seconds between looks: often at first, seldom while nothing happens."""


def is_of_steps(study: str, name: str | None) -> bool:
    """Whether a stored study is paid in steps."""
    place = database_at(study)
    return is_paid_in_steps(SqlLog(place, chosen_name(place, name)).read())


def opened(study: str, name: str | None, cmdp: CMDP, artifacts: str | None) -> StepStudy:
    """The study, with the strategy that it was made with.

    Raises:
        StudyError: it is of another problem, or its strategy is none of ours.
    """
    found = StepStudy.load(study, name, artifacts=artifacts)
    spec = found.spec
    if spec.problem and spec.problem != cmdp.id:
        raise StudyError(
            f"{found.name!r} is a study of {spec.problem!r}, got {cmdp.id!r}; name its problem"
        )
    recorded = without_origin(spec.strategy)
    ours = without_origin(described(describe_selector(found.strategy)))  # type: ignore[arg-type]
    if difference := first_difference(recorded, ours):
        raise StudyError(
            f"a worker decides by the strategy of the study, and {recorded['name']!r} with "
            f"{difference[0]} = {difference[1]!r} is none that the command line knows; run it from "
            "Python: mbtl.StepStudy.load(..., strategy=...).run()"
        )
    return found


def check_options(given: Mapping[str, bool]) -> None:
    """Refuse options that mean nothing with steps.

    Raises:
        InvalidInput: one is given.
    """
    if wrong := [option for option, is_given in given.items() if is_given]:
        raise InvalidInput(
            f"this study is paid in steps, where {' and '.join(wrong)} "
            f"{'means' if len(wrong) == 1 else 'mean'} nothing; leave that out"
        )


def report(study: StepStudy, why: str, *, as_json: bool) -> None:
    """What this worker says at its end."""
    state = study.refresh()
    why = state.stopped or why
    if as_json:
        print_json(
            {"study": study.name, "worker": study.worker, "ended": why, "spent": state.spent,
             "budget": study.spec.budget, "finished": study.is_finished}
        )  # fmt: skip
        return
    console.print(
        f"{study.worker} ends: {why}; {counted(state.spent)} of {counted(study.spec.budget)} steps "
        "are paid",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )


def follow(study: StepStudy, start: str) -> None:
    """Show what workers do, until nothing is left; an interrupt leaves them alone."""
    if study.is_finished:
        return
    said = f"start workers, as many as you like, wherever the database is reached:\n  {start}"
    console.print(said, style="yellow", markup=False, highlight=False, soft_wrap=True)
    with StepProgress(console) as live:
        pause, known = _LOOK, _facts(study)
        while not study.is_finished:
            time.sleep(pause)
            study.refresh()
            now = _facts(study)
            pause = _LOOK if now != known else min(1.5 * pause, _LONGEST_LOOK)
            for number, training in enumerate(now["trainings"]):
                if training not in known["trainings"][number : number + 1]:
                    live.on_trained(study, number)
            for i, policy in enumerate(study.state.policies):
                if now["rows"][i] != dict(enumerate(known["rows"])).get(i):
                    live.on_evaluated(study, policy)
            known = now


def _facts(study: StepStudy) -> dict[str, Any]:
    """What is told when it changes."""
    state = study.state
    return {
        "trainings": [(t.steps, t.length, t.failed) for t in state.trainings],
        "rows": list(state.evaluation_steps),
    }
