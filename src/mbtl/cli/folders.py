"""Folders of studies on the command line."""

from __future__ import annotations

from pathlib import Path

from mbtl.cli.common import console
from mbtl.errors import InvalidInput


def check_folder(folder: Path) -> None:
    """Refuse one that holds something else."""
    if folder.exists() and not (folder / "study.db").exists() and any(folder.iterdir()):
        raise InvalidInput(
            f"{folder} holds something that is not a study; choose another with --study"
        )


def set_aside(folder: Path) -> None:
    """Rename an existing study folder; nothing is ever deleted."""
    if not folder.exists():
        return
    if folder.resolve() == Path.cwd():
        raise InvalidInput(
            "--new renames the study's folder, so that cannot be the folder you are in; go one up"
        )
    number = 1
    while (aside := folder.with_name(f"{folder.name}.{number}")).exists():
        number += 1
    folder.rename(aside)
    console.print(f"set aside: {folder} is now {aside}", markup=False, highlight=False)
