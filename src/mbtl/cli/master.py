"""`mbtl run --workers`: a study that others train is made, waited for, and summed up."""

from __future__ import annotations

import shlex
import time
from pathlib import Path

from mbtl.cli.common import console
from mbtl.errors import InvalidInput
from mbtl.study import Study
from mbtl.study.database import as_url, database_file
from mbtl.study.study import begin_again, estimate

_LOOK = 0.5
"""Seconds between looks."""


def check_master(url: str, *, new: bool, parallel: int) -> None:
    """Refuse options that mean nothing where others train.

    Raises:
        InvalidInput: one is given.
    """
    if new:
        raise InvalidInput(
            f"--new sets a folder aside, and this study lives in {url}; name another one with "
            "--study FOLDER"
        )
    if parallel > 1:
        raise InvalidInput(
            f"with --workers nothing is trained here, got --parallel {parallel}; start as many "
            "`mbtl worker` as you want trainings at a time"
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
    """Say how far workers are, until nothing is left; an interrupt leaves them alone.

    Args:
        study: theirs.
        start: the command that starts one.
        retry_failed: what failed is to be trained again.
    """
    if retry_failed:
        begin_again(study)
    if study.is_finished:
        return
    where = "wherever the database is reached"
    console.say(f"start workers, as many as you like, {where}:\n  {start}", "yellow")
    said = ""
    while True:
        state = study.refresh()
        done = f"{state.spent_words(answered=True)} done"
        if state.rows:
            done += f", {estimate(study)}"
        if state.failures:
            done += f"; {len(state.failures)} failed"
        if done != said and state.picks:
            console.say(done, "yellow")
        if study.is_finished:
            return
        said = done
        time.sleep(_LOOK)
