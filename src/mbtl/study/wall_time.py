"""Wall time: a worker on a cluster ends before the batch system ends it."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from mbtl.study.artifacts import FolderStore
from mbtl.study.study import Study
from mbtl.trainers.contract import Trainer

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
