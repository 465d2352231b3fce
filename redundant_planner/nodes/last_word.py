"""A second process that brings the arm to rest if planner_node's own dies in motion.

Python cannot handle SIGKILL or a segmentation fault, and a velocity command holds until the next
one. So planner_node forks before it starts, and notes every command in memory that both processes
share. The fork waits at a pipe whose other end only the planner holds. The system closes that end
when the planner dies, for any reason.
"""

from __future__ import annotations

from dataclasses import asdict
import gc
import json
import mmap
import os
import time
import warnings

import numpy as np
import numpy.typing as npt

from redundant_planner.nodes import runtime
from redundant_planner.nodes.command_memory import (
    CommandMemory,
    HAS_FAILED,
    HAS_STARTED,
    NUMBER,
    OWN_LISTENERS,
    PLANNERS_LISTENERS,
    SIZE,
    STATE,
)
from redundant_planner.nodes.second_process import Brief, END, live_as_second, PAUSE

Array = npt.NDArray[np.float64]

# The states of the second process while nothing is wrong.
STARTING, READY = 'starting', 'ready'
# How long the planner waits at its own end for the other process to leave [s].
_LEAVING = 1.0


class LastWord:
    """The planner's side: it briefs the other process, and tells it when to leave."""

    def __init__(self, pid: int, pipe: int, memory: mmap.mmap | None, trouble: str = '') -> None:
        """Use `stand_by` or `absent` instead."""
        self._pid, self._pipe, self._memory = pid, pipe, memory
        self._commands = CommandMemory(memory) if memory is not None else None
        self._trouble = trouble
        self._briefed = False

    @classmethod
    def absent(cls, why: str) -> LastWord:
        """Return one without a second process."""
        return cls(0, -1, None, why)

    @classmethod
    def stand_by(cls, args: list[str] | None) -> LastWord:
        """Start the other process; call it before `rclpy.init`, it then calls that itself.

        Args:
            args: command line for `rclpy.init`.
        """
        runtime.keep_off_shared_memory()
        try:
            memory = mmap.mmap(-1, SIZE)
            read_end, write_end = os.pipe()
        except OSError as error:
            return cls.absent(f'no pipe or no memory to share: {error}')
        # Objects that the collector has seen stay shared between the two processes.
        gc.collect()
        gc.freeze()
        try:
            with warnings.catch_warnings():
                # Python warns of other threads: OpenBLAS's stop for a fork, LTTng's do no harm.
                warnings.simplefilter('ignore', DeprecationWarning)
                pid = os.fork()
        except OSError as error:
            os.close(read_end)
            os.close(write_end)
            return cls.absent(f'no second process: {error}')
        if pid == 0:
            live_as_second(read_end, memory, args)
        os.close(read_end)
        return cls(pid, write_end, memory)

    def brief(self, brief: Brief) -> None:
        """Tell the second process about the robot, before the first command."""
        if self._commands is None:
            return
        if not self._commands.prepare(len(brief.joint_names)):
            self._trouble = f'{len(brief.joint_names)} joints are too many for it'
            return
        self._briefed = self._tell(json.dumps(asdict(brief)).encode() + b'\n')

    def note(self, stamp_ns: int, positions: Array, velocities: Array) -> None:
        """Note a command that is about to be published, (n,) each [rad, m; per s]."""
        if self._briefed and self._commands is not None:
            self._commands.note(stamp_ns, positions, velocities)

    @property
    def stands_by(self) -> bool:
        """Whether the second process publishes the planner's outputs, or is about to."""
        return self._briefed and not self._trouble

    def state(self, listeners: int) -> str:
        """Return `STARTING`, `READY`, or why no process would stop the arm.

        Args:
            listeners: how many subscribe to the planner's outputs that owe a stop; the other
                process is ready when as many have found it.
        """
        if not self._trouble and self._memory is not None:
            NUMBER.pack_into(self._memory, PLANNERS_LISTENERS, listeners)
            if self._has_left():
                self._trouble = 'its process has ended'
            elif self._memory[STATE] == HAS_FAILED:
                self._trouble = 'its process could not start its node'
            else:
                found, = NUMBER.unpack_from(self._memory, OWN_LISTENERS)
                started = self._memory[STATE] == HAS_STARTED
                return READY if started and found >= listeners else STARTING
        return self._trouble

    def end(self) -> None:
        """End the other process without a stop, as the arm rests."""
        if self._pipe >= 0:
            self._tell(END)
            self._leave()

    def hand_over(self) -> None:
        """Have the other process stop the arm, as this one cannot; publish nothing afterwards."""
        if self._pipe >= 0:
            self._leave()

    def _leave(self) -> None:
        os.close(self._pipe)
        self._pipe = -1
        deadline = time.monotonic() + _LEAVING
        while not self._has_left() and time.monotonic() < deadline:
            time.sleep(PAUSE)

    def _tell(self, line: bytes) -> bool:
        try:
            return os.write(self._pipe, line) == len(line)
        except OSError as error:
            self._trouble = f'its process does not listen: {error}'
            return False

    def _has_left(self) -> bool:
        if self._pid:
            try:
                if os.waitpid(self._pid, os.WNOHANG)[0]:
                    self._pid = 0
            except ChildProcessError:
                self._pid = 0
        return self._pid == 0
