"""The latest command, in memory that planner_node and its second process share."""

from __future__ import annotations

import mmap
import struct
import time
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Shared memory: the number of commands so far, the state of the second process, the listeners of
# the planner and of the second process, and three places for commands. The planner writes them in
# turns: if it dies while writing one, the two before it are whole.
SIZE = 1 << 16
_COUNT = struct.Struct('@Q')  # native, as it is then written at once
STATE = _COUNT.size
NUMBER = struct.Struct('@I')
PLANNERS_LISTENERS, OWN_LISTENERS = 16, 20
_COMMANDS = 64
_PLACES = 3
HAS_STARTED, HAS_FAILED = 1, 2


class NotedCommand(NamedTuple):
    """A command as the planner noted it.

    Attributes:
        time: when, by the system's monotonic clock [s].
        stamp_ns: of its message [ns].
        positions, velocities: (n,) [rad, m; per s].
        before: (n,) velocities of the command before it; 0 if it is the first.
    """

    time: float
    stamp_ns: int
    positions: Array
    velocities: Array
    before: Array


class CommandMemory:
    """The latest command, in memory that two processes share."""

    def __init__(self, memory: mmap.mmap) -> None:
        """Use `SIZE` bytes of zeros."""
        self._memory = memory
        self._command = struct.Struct('@dq')
        self._n = self._count = 0

    def prepare(self, n: int) -> bool:
        """Make places for commands of n joints; return whether there is room for them."""
        self._n, self._command = n, struct.Struct(f'@dq{2 * n}d')
        return _COMMANDS + _PLACES * self._command.size <= SIZE

    def note(self, stamp_ns: int, positions: Array, velocities: Array) -> None:
        """Write the latest command; 2 µs."""
        self._count += 1
        self._command.pack_into(
            self._memory, self._place(self._count), time.monotonic(), stamp_ns,
            *positions.tolist(), *velocities.tolist())
        _COUNT.pack_into(self._memory, 0, self._count)

    def latest(self) -> NotedCommand | None:
        """Return the latest command; None without one."""
        count, = _COUNT.unpack_from(self._memory, 0)
        if not count:
            return None
        when, stamp_ns, *numbers = self._command.unpack_from(self._memory, self._place(count))
        # Of none before the first, the memory says 0.
        before = self._command.unpack_from(self._memory, self._place(count - 1))
        return NotedCommand(when, stamp_ns, np.array(numbers[:self._n]),
                            np.array(numbers[self._n:]), np.array(before[2 + self._n:]))

    def _place(self, count: int) -> int:
        return _COMMANDS + count % _PLACES * self._command.size
