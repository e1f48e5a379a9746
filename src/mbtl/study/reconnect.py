"""Patience: a database server that is away is waited for, so that its restart costs nothing."""

from __future__ import annotations

import math
import random
import time
from logging import getLogger

from mbtl.errors import Unreachable

_logger = getLogger(__name__)

PATIENCE = 300.0
"""Seconds without an answer after which a study gives up."""
_PAUSE, _LONGEST_PAUSE = 0.1, 2.0


class Patience:
    """How long is waited for one database.

    When that was too long nothing is waited for again until it has answered: whoever cleans up
    after the error hears at once that it cannot.

    Args:
        seconds: for which it may be away.
    """

    def __init__(self, seconds: float = PATIENCE) -> None:
        self.seconds = seconds
        self._since: float | None = None

    def wait(self, error: Unreachable) -> None:
        """Sleep a moment before the next try.

        Raises:
            Unreachable: the error itself, when it has lasted too long.
        """
        now = time.monotonic()
        if self._since is None:
            self._since = now
            if self.seconds > 0.0:
                _logger.warning("%s; trying again for %.0f s", error, self.seconds)
        away = now - self._since
        if away >= self.seconds:
            raise error
        pause = min(_PAUSE + away / 5.0, _LONGEST_PAUSE) * random.uniform(0.5, 1.0)
        try:
            time.sleep(min(pause, self.seconds - away))
        except BaseException:  # an interrupt: who wants to end has no patience left
            self._since = -math.inf
            raise

    def answered(self) -> None:
        """It is there."""
        if self._since is not None:
            self._since = None
            _logger.warning("the database answers again")
