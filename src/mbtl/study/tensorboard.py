"""TensorBoard for a study, where that is installed."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from mbtl.errors import missing_extra
from mbtl.study.records import Pick
from mbtl.study.study import Callback, Study
from mbtl.trainers.contract import Progress


class TensorBoardCallback(Callback):
    """TensorBoard for a study: the metrics of each training, and some numbers per pick.

    These are `study/V`, the running estimate, `study/V_margin`, half its 95 % interval where it is
    known, `study/source` and `study/training_performance`.

    Args:
        folder: where TensorBoard looks.

    Raises:
        MissingExtra: tensorboard is not installed.
    """

    def __init__(self, folder: Path) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ModuleNotFoundError as error:
            raise missing_extra("tensorboard", "train") from error
        self._writer: Any = SummaryWriter(str(folder / "study"))

    def on_progress(self, study: Study, pick: Pick, progress: Progress) -> None:
        """Metrics of one training, under its source."""
        with suppress(OSError):  # of a full disk, as below: pictures are not worth the study
            for name, value in progress.metrics.items():
                self._writer.add_scalar(f"source-{pick.source:04d}/{name}", value, progress.step)

    def on_told(self, study: Study, pick: Pick) -> None:
        """One point per pick."""
        k = len(study.state.rows)
        now = study.routing.value
        own = float(study.history.training_performance[-1])
        with suppress(OSError):
            self._writer.add_scalar("study/V", now.value, k)
            if study.routing.noise_is_known:
                self._writer.add_scalar("study/V_margin", now.margin, k)
            self._writer.add_scalar("study/source", pick.source, k)
            self._writer.add_scalar("study/training_performance", own, k)
            self._writer.flush()

    def on_end(self, study: Study) -> None:
        """Close the file."""
        with suppress(OSError):
            self._writer.close()
