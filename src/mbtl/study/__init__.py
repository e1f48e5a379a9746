"""Study: ask, tell, run. Storage is an event log; state is a replay of it."""

from mbtl.study.artifacts import Artifact, ArtifactStore
from mbtl.study.budget import Cost, Steps
from mbtl.study.create import Evaluation, Stopping, create_study, load_study
from mbtl.study.listing import StudyEntry, delete_study, list_studies
from mbtl.study.records import Pick, StudyFinished, StudyWaiting
from mbtl.study.storage import EventLog, MemoryLog, SqlLog, study_names
from mbtl.study.study import Callback, Failures, RunResult, Study, Workers
from mbtl.study.trainings import Training

__all__ = [
    "Artifact",
    "ArtifactStore",
    "Callback",
    "Cost",
    "Evaluation",
    "EventLog",
    "Failures",
    "MemoryLog",
    "Pick",
    "RunResult",
    "SqlLog",
    "Steps",
    "Stopping",
    "Study",
    "StudyEntry",
    "StudyFinished",
    "StudyWaiting",
    "Training",
    "Workers",
    "create_study",
    "delete_study",
    "list_studies",
    "load_study",
    "study_names",
]
