"""Watches for moments in which the machine itself stood still, so that a test can tell.

A virtual machine may be stopped by its host, and a busy one lets a process wait for its turn. On
each core a process of its own sleeps for a millisecond at a time and notes when it overslept. A
process that sleeps so much is served first, and does not see that busy ones wait; Linux counts
their waiting.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from types import TracebackType

_STEP = 1e-3
# What a watcher writes down [s]; less than that is every system's daily life.
_NOTABLE = 4e-3
# How long, since the machine started, work has waited for a core, a disk or memory.
_PRESSURE = [Path('/proc/pressure', resource) for resource in ('cpu', 'io', 'memory')]


def waited() -> float:
    """Return for how long, so far, some process of the machine had to wait [s].

    Only differences mean something. It is 0.0 where Linux does not count (no `/proc/pressure`, or
    one that says so).
    """
    longest = 0.0
    for resource in _PRESSURE:
        with contextlib.suppress(OSError):
            total = resource.read_text().partition('total=')[2].split()[0]
            longest = max(longest, 1e-6 * int(total))
    return longest


class Standstill:
    """Watches the machine for as long as its `with` block lasts."""

    def __enter__(self) -> Standstill:
        """Start a watcher on each core that this process may use."""
        self._seen: list[tuple[float, float]] = []
        self._folder = tempfile.TemporaryDirectory()
        self._files = [Path(self._folder.name, str(core)) for core in os.sched_getaffinity(0)]
        # A session of its own, as the nodes have: Linux shares a core among sessions.
        self._watchers = [
            subprocess.Popen([sys.executable, '-S', __file__, file.name, str(file)],
                             start_new_session=True)
            for file in self._files]
        while not all(file.exists() for file in self._files):
            time.sleep(_STEP)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the watchers; what they have seen is still known."""
        for watcher in self._watchers:
            watcher.kill()
            watcher.wait()
        self._seen = self._read()
        self._files.clear()
        self._folder.cleanup()

    def _read(self) -> list[tuple[float, float]]:
        lines = [line for file in self._files for line in file.read_text().splitlines()]
        return [(float(since), float(until)) for since, until in map(str.split, lines)]

    def gaps(self, begin: float, end: float) -> list[tuple[float, float]]:
        """Return from when to when a core stood still, cut to an interval by `time.time()` [s]."""
        return sorted((max(since, begin), min(until, end)) for since, until in self._seen
                      + self._read() if since < end and until > begin)

    def longest(self, begin: float, end: float) -> float:
        """Return the longest standstill of a core within an interval by `time.time()` [s]."""
        return max((until - since for since, until in self.gaps(begin, end)), default=0.0)

    def lost(self, begin: float, end: float) -> float:
        """Return how long some core stood still within an interval by `time.time()` [s].

        Work that takes its turn several times over waits several times.
        """
        total, counted = 0.0, begin
        for since, until in self.gaps(begin, end):
            total += max(until - max(since, counted), 0.0)
            counted = max(counted, until)
        return total


def _watch(core: int, file: str) -> None:
    """Write a line 'begin end' for every gap, until killed or left alone."""
    os.sched_setaffinity(0, {core})
    parent = os.getppid()
    with open(file, 'w', buffering=1) as out:
        last = time.time()
        while os.getppid() == parent:
            time.sleep(_STEP)
            now = time.time()
            if now - last > _NOTABLE:
                out.write(f'{last:.6f} {now:.6f}\n')
            last = now


if __name__ == '__main__':
    _watch(int(sys.argv[1]), sys.argv[2])
