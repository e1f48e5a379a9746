"""Folders of studies on the command line."""

from __future__ import annotations

from pathlib import Path

from mbtl.cli.common import console
from mbtl.errors import InvalidInput
from mbtl.study.database import check_name, check_path, shown
from mbtl.study.storage import names_in

DATABASE = "study.db"


def study_in(folder: Path) -> str:
    """Name of the study that lives in a folder; of a new one, the folder's.

    A folder that was renamed or copied holds the study it held.

    Raises:
        InvalidInput: it holds several, none of which is called like the folder.
    """
    own, names = folder.resolve().name, names_in(folder / DATABASE)
    if own in names or not names:
        return own
    if len(names) > 1:
        raise InvalidInput(
            f"--study takes a folder with one study, and {folder} holds {len(names)} "
            f"({', '.join(names)}); give the folder one of these names"
        )
    return names[0]


def _check_place(folder: Path) -> None:
    """Refuse what can be no folder of a study, before it is looked at."""
    check_path(folder)
    if ":/" in str(folder)[2:]:  # a path has lost one of two slashes; C:/ is a drive
        raise InvalidInput(
            f"--study takes a folder, got the URL {shown(str(folder).replace(':/', '://', 1))}; "
            "the database of a study that workers train is --workers URL"
        )
    check_name(folder.resolve().name)
    if folder.name == DATABASE or folder.is_file():
        raise InvalidInput(
            f"--study takes the folder of a study, got the file {folder}; give {folder.parent}"
        )


def check_folder(folder: Path) -> None:
    """Refuse one that holds something else."""
    _check_place(folder)
    if folder.exists() and not (folder / DATABASE).exists() and any(folder.iterdir()):
        raise InvalidInput(
            f"{folder} holds something that is not a study; choose another with --study"
        )


def set_aside(folder: Path) -> None:
    """Rename an existing study folder; nothing is ever deleted."""
    _check_place(folder)
    if not folder.exists():
        return
    if folder.resolve() == Path.cwd():
        raise InvalidInput(
            "--new renames the study's folder, so that cannot be the folder you are in; go one up"
        )
    renamed(folder)


def renamed(folder: Path) -> None:
    """Give a folder another name, and say so."""
    number = 1
    while (aside := folder.with_name(f"{folder.name}.{number}")).exists():
        number += 1
    folder.rename(aside)
    console.say(f"set aside: {folder} is now {aside}")
