"""`mbtl worker`: trains what a study picks, beside as many others, until the study is finished."""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np
import typer

from mbtl.cli.common import JsonFlag, console, interrupts, option, print_json
from mbtl.cli.interrupts import interrupt_main
from mbtl.cli.progress import LiveProgress
from mbtl.errors import InvalidInput, StudyError, TrainingFailed
from mbtl.problems import CMDP, resolve_cmdp
from mbtl.study import Study, load_study
from mbtl.study.artifacts import FolderStore
from mbtl.study.study import LEASE, Failures, Workers, run
from mbtl.trainers.contract import Trainer, recipe_of

_LENGTHS = ("timesteps", "episodes", "eval_episodes")
"""What `mbtl run` may change of a recipe: a worker takes it from the study."""
_option = partial(option, None)
_RESERVE = 30.0
"""Seconds of the wall time that are kept for giving back; at most a tenth of it."""
_LONG = 0.9
"""So many of the trainings so far took no longer than what the next one is expected to take."""


@dataclass(frozen=True)
class WallTime:
    """When a process has to be over.

    Attributes:
        end: by `time.monotonic`.
    """

    end: float

    @property
    def left(self) -> float:
        """Seconds."""
        return self.end - time.monotonic()

    def has_room(self, study: Study, trainer: Trainer) -> bool:
        """True where one more training is worth beginning.

        It is expected to take as long as nine of ten trainings of this study did, evaluation
        included. One that can go on elsewhere from its checkpoint is begun in any case.
        """
        if self.left <= 0.0:
            return False
        if "resume" in trainer.takes and isinstance(study.artifacts, FolderStore):
            return True
        took = [row.seconds for row in study.state.rows if row.seconds is not None]
        return not took or float(np.quantile(took, _LONG)) <= self.left


def worker(
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY_URL", help="Database of the study: a URL, or its folder or file."
        ),
    ],
    problem: Annotated[
        str,
        typer.Argument(metavar="CMDP", help="What it is a study of: an id, or module:problem."),
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
    wall_time: Annotated[
        str | None, _option("End within this time: 90m, 2h, 1:30:00 or seconds.", metavar="TIME")
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
    a worker that dies is succeeded. Ctrl-C, SIGTERM and the wall time give a training back at once.

    Example: mbtl worker postgresql+psycopg://me@db/studies my_problem.py:problem --wall-time 4h
    """
    failures = Failures(stop_after_failures, retries=retries, rehearse=not no_rehearsal)
    alone = Workers(lease=lease, timeout=timeout)
    end = None if wall_time is None else _end(wall_time)
    cmdp = resolve_cmdp(problem, engine=engine, score=score)
    over = threading.Event()
    opened: Study | None = None
    with _spoken(), _alarm(end, over):
        try:
            opened = load_study(study, name, problem=cmdp, artifacts=artifacts, strategy=strategy)
            trainer = _as_recorded(cmdp, opened)
            has_room = None if end is None else partial(end.has_room, opened, trainer)
            with LiveProgress(opened, console) as live:
                run(
                    opened,
                    trainer,
                    workers=alone,
                    failures=failures,
                    callbacks=[live],
                    report=False,
                    accept_changes=accept_changes,
                    may_begin=has_room,
                    wait=not no_wait,
                )
        except KeyboardInterrupt:
            if not over.is_set():
                raise
            interrupts.append("worker")  # in the middle of something: see `program`
    if opened is None:
        raise StudyError("the wall time is over, and nothing was begun: the study was not open yet")
    why = "the wall time is over"
    if not over.is_set():
        check_evaluated(opened)
        why = "others are at the last trainings"
        if has_room is not None and not has_room():
            why = "no further training would end within the wall time"
    _report(opened, why, as_json=as_json)


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
            "again: nothing is trained twice"
        )


def _end(wall_time: str) -> WallTime:
    """When to be over, a little early."""
    seconds = _seconds(wall_time)
    if seconds <= 0.0:
        raise InvalidInput(f"the time of a worker ends in the future, got {wall_time!r}")
    return WallTime(time.monotonic() + seconds - min(_RESERVE, seconds / 10.0))


def _seconds(text: str) -> float:
    units = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
    if found := re.fullmatch(r"(\d+(?:\.\d+)?)([smhd]?)", text.strip()):
        return float(found[1]) * units[found[2]]
    if re.fullmatch(r"(\d+-)?\d+(:\d\d){1,2}", text.strip()):  # as batch systems write it
        days, _, clock = text.strip().rpartition("-")
        parts = [int(part) for part in clock.split(":")]
        hours, minutes, seconds = parts if len(parts) == 3 else (0, *parts)
        return float(int(days or 0) * 86400 + hours * 3600 + minutes * 60 + seconds)
    raise InvalidInput(f"--wall-time is written 90m, 2h, 1:30:00 or in seconds, got {text!r}")


@contextmanager
def _alarm(end: WallTime | None, over: threading.Event) -> Iterator[None]:
    """An interrupt of the block at the end, whatever it is at."""
    if end is None:
        yield
        return

    def ring() -> None:
        over.set()
        interrupt_main()

    timer = threading.Timer(max(end.left, 0.0), ring)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


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


def _report(study: Study, why: str, *, as_json: bool) -> None:
    mine = [one for one in study.trainings if one.worker == study.worker]
    told = sum(one.place is not None for one in mine)
    rows, why = len(study.state.rows), str(study.stop_reason) if study.is_finished else why
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
