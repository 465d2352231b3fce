"""The watcher sees a process stand still, and only while it does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest
from standstill import Standstill, waited


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


@pytest.mark.skipif(not waited(), reason='Linux does not count here who waits')
def test_work_that_waits_for_a_core_is_counted():
    before, begin = waited(), time.monotonic()
    work = [sys.executable, '-c', 'while True: pass']
    children = [subprocess.Popen(work) for _ in range(len(os.sched_getaffinity(0)) + 2)]
    try:
        deadline = begin + 30.0
        while waited() - before < 0.2:
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        for child in children:
            child.kill()
            child.wait()
    assert waited() - before < time.monotonic() - begin + 2.0
