"""`mbtl worker`: trains what a study picks, beside as many others, until the study is finished."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Annotated

import typer

from mbtl.cli.common import JsonFlag, console, option, print_json
from mbtl.cli.progress import LiveProgress
from mbtl.errors import TrainingFailed
from mbtl.problems import CMDP, resolve_cmdp
from mbtl.study import Study, load_study
from mbtl.study.study import LEASE, Failures, Workers, run
from mbtl.trainers.contract import Trainer, recipe_of

_LENGTHS = ("timesteps", "episodes", "eval_episodes")
"""What `mbtl run` may change of a recipe: a worker takes it from the study."""
_option = partial(option, None)


def worker(
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY_URL", help="Database of the study: a URL, or its folder or file."
        ),
    ],
    problem: Annotated[
        str, typer.Argument(metavar="CMDP", help="What it is a study of: an id, or module:problem.")
    ],
    name: Annotated[str | None, _option("Name of the study, where there are several.")] = None,
    artifacts: Annotated[
        str | None, _option("Folder or URL of the policies, the same for all workers.")
    ] = None,
    engine: Annotated[
        str | None, _option("jax, gymnasium or sumo; default: the fastest there is.")
    ] = None,
    score: Annotated[
        str | None, _option("What an episode of traffic is worth: paper, or the CMDP's own.")
    ] = None,
    strategy: Annotated[
        str | None, _option("Only for a rule of your own: as the study was made with.")
    ] = None,
    no_wait: Annotated[
        bool, _option("End when nothing is left to begin; others may be training.", "--no-wait")
    ] = False,
    lease: Annotated[
        float, _option("Seconds of silence after which others take a training over.")
    ] = LEASE,
    retries: Annotated[
        int, _option("Times a failed training is begun again before it counts.")
    ] = 0,
    timeout: Annotated[
        float | None, _option("Seconds that a training with its evaluation may take.")
    ] = None,
    stop_after_failures: Annotated[
        int, _option("End after so many failed trainings in a row.")
    ] = 3,
    no_rehearsal: Annotated[
        bool, _option("Skip the trial evaluation before the first training.", "--no-rehearsal")
    ] = False,
    accept_changes: Annotated[
        bool, _option("Go on although your functions changed since then.", "--accept-changes")
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Train what a study picks, beside other workers, until it is finished.

    Start as many as you like, on any host that reaches the database: nothing is trained twice, and
    a worker that dies is succeeded. Ctrl-C and SIGTERM give a training back at once.

    Example: mbtl worker postgresql+psycopg://me@db/studies my_problem.py:problem
    """
    failures = Failures(stop_after_failures, retries=retries, rehearse=not no_rehearsal)
    alone = Workers(lease=lease, timeout=timeout)
    cmdp = resolve_cmdp(problem, engine=engine, score=score)
    with _spoken():
        opened = load_study(study, name, problem=cmdp, artifacts=artifacts, strategy=strategy)
        with LiveProgress(opened, console) as live:
            run(
                opened,
                _as_recorded(cmdp, opened),
                workers=alone,
                failures=failures,
                callbacks=[live],
                report=False,
                accept_changes=accept_changes,
                wait=not no_wait,
            )
    check_evaluated(opened)
    _report(opened, as_json=as_json)


def check_evaluated(study: Study) -> None:
    """Refuse to call that done where policies are trained and could not be evaluated.

    Raises:
        TrainingFailed: so it is.
    """
    if study.state.deferred:
        count = len(study.state.deferred)
        raise TrainingFailed(
            f"{count} {'policy is' if count == 1 else 'policies are'} trained and could not be "
            "evaluated (`mbtl study show` says why); mend the cause, then run the same command "
            "again: nothing is trained twice (with `mbtl run --retry-failed`, these are)"
        )


@contextmanager
def _spoken() -> Iterator[None]:
    """In the block, what the storage has to say is said, such as that a server does not answer."""
    handler = logging.Handler()
    handler.emit = lambda record: console.say(record.getMessage(), "yellow")  # type: ignore[method-assign]
    logger = logging.getLogger("mbtl.study.database")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


def _as_recorded(cmdp: CMDP, study: Study) -> Trainer:
    """The trainer of the study's preset, with lengths that were given to `mbtl run`."""
    trainer = study.trainer or cmdp.trainer_for(study.spec.settings.get("preset"))
    recorded, own = study.spec.settings.get("recipe", {}), recipe_of(trainer)
    changed = {
        key: recorded[key]
        for key in _LENGTHS
        if key in own and recorded.get(key, own[key]) != own[key]
    }
    return cmdp.trainer_for(study.spec.settings.get("preset"), **changed) if changed else trainer


def _report(study: Study, *, as_json: bool) -> None:
    mine = [one for one in study.trainings if one.worker == study.worker]
    told = sum(one.place is not None for one in mine)
    rows, why = len(study.state.rows), "others are at the last trainings"
    if study.is_finished:
        why = str(study.stop_reason)
    if as_json:
        failed = sum(one.state == "failed" for one in mine)
        facts = {"study": study.name, "worker": study.worker, "told": told, "failed": failed}
        facts |= {"ended": why, "finished": study.is_finished}
        print_json({**facts, "rows": rows, "budget": study.spec.budget})
        return
    console.say(
        f"{study.worker} ends: {why}; it told {told} of the {rows} rows so far, "
        f"{study.state.spent_words()} asked for"
    )
