"""`mbtl run --workers`: a study that others train is made, shown while they do, and summed up."""

from __future__ import annotations

import shlex
import time
from pathlib import Path

from mbtl.cli.common import console
from mbtl.cli.progress import LiveProgress
from mbtl.errors import InvalidInput
from mbtl.study import Callback, Study, ask
from mbtl.study.database import as_url, database_file
from mbtl.trainers.contract import Progress

_LOOK, _LONGEST_LOOK = 0.1, 2.0
"""Seconds between looks: often at first, seldom while nothing happens."""
_IDLE = 60.0
"""Seconds without any worker after which it is said."""


def check_master(url: str, *, new: bool, parallel: int, tensorboard: Path | None) -> None:
    """Refuse options that mean nothing where others train.

    Raises:
        InvalidInput: one is given.
    """
    if new:
        raise InvalidInput(
            f"--new sets a folder aside, and this study lives in {url}; name another one with "
            "--study FOLDER"
        )
    given = {"--parallel": parallel > 1, "--tensorboard": tensorboard is not None}
    for option, is_given in given.items():
        if is_given:
            raise InvalidInput(
                f"with --workers nothing is trained here, got {option}; start as many `mbtl "
                "worker` as you want trainings at a time"
            )


def artifacts_for(url: str, given: str | None, folder: Path) -> str | None:
    """Where the policies go: a server cannot keep them, so they go to the study's folder."""
    if given is not None or database_file(as_url(url)) is not None:
        return given
    return str(folder.absolute())


def command(url: str, name: str, problem: str, strategy: str = "", **options: str | None) -> str:
    """What starts a worker of this study; `options` are further ones by name, if they are given."""
    words = ["mbtl", "worker", url, problem, "--name", name]
    optional = {f"--{key}": value for key, value in options.items()}
    optional["--strategy"] = strategy if ":" in strategy else None  # a rule of the user's own
    words += [word for key, value in optional.items() if value for word in (key, value)]
    return shlex.join(words)


def follow(study: Study, start: str, *, retry_failed: bool = False) -> None:
    """Show what workers do, until nothing is left; an interrupt leaves them alone.

    Args:
        study: theirs.
        start: the command that starts one.
        retry_failed: what failed is to be trained again.
    """
    for failed in list(study.state.failures) if retry_failed else []:
        study.retry(failed.pick)
    if study.is_finished:
        return
    _say(f"start workers, as many as you like, wherever the database is reached:\n  {start}")
    with LiveProgress(study, console) as live:
        news, pause, idle, said = _News(study, live), _LOOK, 0.0, False
        while not study.is_finished:
            pause = _LOOK if news.tell() else min(1.5 * pause, _LONGEST_LOOK)
            held = ask.others(study.state, study.watch(), study.worker)
            idle = 0.0 if held or study.state.proposing else idle + pause
            said = said and idle > 0.0
            if idle > _IDLE and not said and study.state.picks:
                said = True
                _say("nobody works on this study now; start workers, and it goes on")
            time.sleep(pause)
        news.tell()


class _News:
    """Tells a callback what has happened since the last look."""

    def __init__(self, study: Study, callback: Callback) -> None:
        self._study, self._callback = study, callback
        self._seq = study.state.seq
        self._open: set[int] = set()
        self._closed = _answered(study)

    def tell(self) -> bool:
        """False when nothing has happened."""
        study = self._study
        before, state = self._seq, study.refresh()
        self._seq = state.seq
        failed = {failure.pick: failure.reason for failure in state.failures}
        now = {n for n, pick in state.open_picks.items() if pick.lease is not None}
        before_that, self._closed = self._closed, _answered(study)
        ended = self._closed - before_that  # perhaps begun and ended between two looks
        for number in sorted((now | ended) - self._open):
            self._callback.on_pick(study, study.pick(number))
        for number in sorted(ended | (self._open - now)):
            pick = study.pick(number)
            if number in failed:
                self._callback.on_failed(study, pick, failed[number])
            elif number in state.open_picks:
                self._callback.on_lost(study, pick)
            else:
                self._callback.on_told(study, pick)
        self._open = now
        self._steps()
        return state.seq != before

    def _steps(self) -> None:
        beats = self._study.log.beats()
        for number in self._open:
            lease = self._study.state.picks[number].lease
            beat = beats.get(lease.token) if lease else None
            if beat is not None and beat.steps is not None:
                metrics = {} if beat.value is None else {"return": beat.value}
                done = Progress(int(beat.steps), 0, metrics)
                self._callback.on_progress(self._study, self._study.pick(number), done)


def _answered(study: Study) -> set[int]:
    """Numbers of the picks that gave something, or failed."""
    return set(range(len(study.state.picks))) - set(study.state.open_picks)


def _say(line: str) -> None:
    console.say(line, "yellow")
