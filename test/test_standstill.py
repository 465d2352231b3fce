"""The watcher sees a process stand still, and only while it does."""

from __future__ import annotations

import signal
import time

import pytest
from standstill import Standstill


def test_a_standstill_is_seen_where_it_was():
    with Standstill() as machine:
        before = time.time()
        for watcher in machine._watchers:
            watcher.send_signal(signal.SIGSTOP)
        begin = time.time()
        time.sleep(0.3)
        end = time.time()
        for watcher in machine._watchers:
            watcher.send_signal(signal.SIGCONT)
        deadline = time.monotonic() + 10.0
        while machine.longest(before, end) < 0.25:
            assert time.monotonic() < deadline, machine.gaps(before, end)
            time.sleep(0.01)
    assert machine.longest(begin, end) == pytest.approx(0.3, abs=0.02)
    assert machine.lost(begin, end) == pytest.approx(0.3, abs=0.02)
    assert machine.lost(begin + 0.1, begin + 0.2) == pytest.approx(0.1, abs=1e-5)
    assert machine.longest(end + 100.0, end + 200.0) == machine.lost(0.0, 1.0) == 0.0
