"""Study: ask, tell, run. Storage is an event log; state is a replay of it."""

from mbtl.study.artifacts import Artifact, ArtifactStore
from mbtl.study.callbacks import Callback
from mbtl.study.create import create_study, load_study
from mbtl.study.listing import StudyEntry, delete_study, list_studies
from mbtl.study.pick import Pick, StudyFinished
from mbtl.study.result import RunResult
from mbtl.study.storage import EventLog, MemoryLog, SqlLog, study_names
from mbtl.study.study import Study
from mbtl.study.trainings import Training, Trainings
from mbtl.study.wishes import Stopping

__all__ = [
    "Artifact",
    "ArtifactStore",
    "Callback",
    "EventLog",
    "MemoryLog",
    "Pick",
    "RunResult",
    "SqlLog",
    "Stopping",
    "Study",
    "StudyEntry",
    "StudyFinished",
    "Training",
    "Trainings",
    "create_study",
    "delete_study",
    "list_studies",
    "load_study",
    "study_names",
]
