"""Where a study keeps its policies: marked when it is made, and looked for by all who work on it.

Several machines may reach one place by different names, so what is compared is what is there.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbtl.errors import StudyMismatch
from mbtl.study.artifacts import ArtifactStore
from mbtl.study.database import shown

if TYPE_CHECKING:
    from mbtl.study.steps.study import StepStudy


def marked(store: ArtifactStore, uid: str) -> dict[str, str]:
    """Leave a mark of a study in its store; what the log says of it.

    Raises:
        StorageError: the place cannot be written.
    """

    def fill(folder: Path) -> bool:
        (folder / "README").write_text("Policies of a study by mbtl.\n", encoding="utf-8")
        return True

    place = f"policies/{uid}/study"
    store.write(place, fill, {"study": uid})
    return {"place": place, "artifacts": _address(store)}


def check_artifacts(study: StepStudy) -> None:
    """Refuse, before an action is taken, to keep policies elsewhere than the study does.

    Studies of before, which left no mark, are known by their first policy. One that is finished
    keeps nothing more.

    Raises:
        StudyMismatch: its policies are not where this object looks for them.
        StorageError: the place cannot be read.
    """
    state, store = study.state, study.artifacts
    marks = (mark.place for course in state.trainings for mark in course.marks.values())
    place = state.kept.get("place") or next((p for p in marks if p is not None), None)
    if study.is_finished or place is None:
        return
    if store is None or store.receipt(place) is None:
        known = state.kept.get("artifacts")
        made = "" if known is None else f", which was {known} where it was made"
        raise StudyMismatch(
            "all who work on a study keep its policies in one place, and those of "
            f"{study.name!r} are not in {'memory' if store is None else _address(store)}; give "
            f"the study's own --artifacts (artifacts=){made}"
        )


def _address(store: Any) -> str:
    return shown(str(getattr(store, "root", None) or getattr(store, "url", store)))
