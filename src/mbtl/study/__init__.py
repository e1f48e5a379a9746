"""Study: ask, tell, run. Storage is an event log; state is a replay of it."""

from mbtl.study.artifacts import Artifact, ArtifactStore
from mbtl.study.callbacks import Callback
from mbtl.study.create import create_study, load_study
from mbtl.study.pick import Pick, StudyFinished
from mbtl.study.storage import EventLog, MemoryLog, SqlLog, study_names
from mbtl.study.study import Study

__all__ = [
    "Artifact",
    "ArtifactStore",
    "Callback",
    "EventLog",
    "MemoryLog",
    "Pick",
    "SqlLog",
    "Study",
    "StudyFinished",
    "create_study",
    "load_study",
    "study_names",
]
