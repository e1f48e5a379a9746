"""A ring whose simulator dies, in a module of its own so that trainers can be sent to processes."""

import os
import signal
from pathlib import Path

from mbtl.zoo.cmdps.traffic.ring import RingAcc


class DoomedRing(RingAcc):
    """Kills its process on the 20th decision, once: in the first process that comes so far."""

    def __init__(self, context, *, marker, home, **settings):
        super().__init__(context, **settings)
        self.marker, self.home, self.decisions = Path(marker), home, 0

    def step(self, action):
        self.decisions += 1
        if self.decisions == 20 and os.getpid() != self.home and not self.marker.exists():
            self.marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().step(action)
