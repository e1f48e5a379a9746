"""What every event log owes: subclass `EventLogContract` and give a `log` fixture."""

import numpy as np
import pytest

from mbtl.study.events import Event
from mbtl.study.storage import Conflict, EventLog


class EventLogContract:
    """Tests that hold for any event log; the `log` fixture is empty and new for each test."""

    def test_events_come_back_numbered_and_whole(self, log: EventLog) -> None:
        """What is read is what was appended."""
        row = np.array([1.5, np.pi, -1e300])
        assert log.append(Event("created", {"a": [1, "x", None, 0.1]}), after=0) == 1
        assert log.append(Event("told", {"source": 3}, {"returns": row}), after=1) == 2
        first, second = log.read()
        assert (first.seq, first.kind, first.data) == (1, "created", {"a": [1, "x", None, 0.1]})
        assert (second.seq, second.kind) == (2, "told")
        assert np.array_equal(second.arrays["returns"], row)
        assert second.time >= first.time > 0

    def test_reading_goes_on_after_a_number(self, log: EventLog) -> None:
        """A follower reads only what is new."""
        for i in range(5):
            log.append(Event("created", {"i": i}), after=i)
        assert [event.data["i"] for event in log.read(3)] == [3, 4]
        assert list(log.read(5)) == []

    def test_the_last_heartbeat_of_each_lease_is_kept(self, log: EventLog) -> None:
        """By the clock that stamps the events."""
        assert dict(log.beats()) == {}
        log.append(Event("created", {}), after=0)
        log.beat("a", 5.0)
        log.beat("b", 5.0)
        log.beat("a", 50.0)
        now, beats = log.now(), log.beats()
        assert set(beats) == {"a", "b"}
        assert beats["a"] > beats["b"] > log.read()[0].time
        assert now - 10.0 < beats["a"] - 50.0 <= now

    def test_a_late_append_conflicts_and_changes_nothing(self, log: EventLog) -> None:
        """Who appends second has to look again."""
        log.append(Event("created", {}), after=0)
        for stale in (0, 2, 7):
            with pytest.raises(Conflict):
                log.append(Event("asked", {"lost": True}), after=stale)
        assert [event.kind for event in log.read()] == ["created"]
