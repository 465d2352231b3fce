"""Nodes of this package as child processes that end with their parent."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import ctypes
from functools import partial
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
from threading import Thread
import time
from types import TracebackType
from typing import IO

from redundant_planner.core.errors import PlannerError

_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of prctl(2)
# How long processes get to end [s].
_END_PATIENCE = 3.0


class LiveError(PlannerError):
    """A process ended, or did not do its part in time."""


class Processes:
    """Nodes of this package as child processes; none outlives the `with` block.

    Attributes:
        environment: of the children: their own ROS domain, on this machine only.
    """

    def __init__(
        self, domain_id: int, hear: Callable[[str, str], object] | None = None,
    ) -> None:
        """Prepare for processes on a ROS domain.

        Args:
            domain_id: of the domain.
            hear: takes a process's name and each line that it writes, on a thread per process;
                they write to the terminal if None.
        """
        self.environment = dict(os.environ, ROS_DOMAIN_ID=str(domain_id),
                                ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._hear = hear

    def __enter__(self) -> Processes:
        """Return itself; processes are started one by one."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End every child, and kill what does not react.

        SIGTERM and not SIGINT: a child still importing dies of it without a word.
        """
        for child in self._children.values():
            if child.poll() is None:
                child.terminate()
        deadline = time.monotonic() + _END_PATIENCE
        for child in self._children.values():
            try:
                child.wait(max(deadline - time.monotonic(), 0.01))
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()

    def start(
        self, node: str | Path, files: Sequence[Path] = (),
        values: Mapping[str, object] | None = None, remap: Mapping[str, str] | None = None,
        name: str = '', options: Sequence[str] = (),
    ) -> subprocess.Popen[bytes]:
        """Start a node of this package.

        Args:
            node: a module of `nodes` such as 'planner_node', or a script that takes the same
                arguments.
            files: parameter files.
            values: single parameters, which win over the files.
            remap: names to remap.
            name: what to call it where several of the same kind run.
            options: of its own, ahead of those of ROS.
        """
        program = ([str(node)] if isinstance(node, Path)
                   else ['-m', f'redundant_planner.nodes.{node}'])
        command = [sys.executable, *program, *options, *ros_arguments(files, values, remap)]
        # A session of its own, so that Ctrl-C reaches us alone and the end is in our order;
        # and a death signal, so that nothing stays behind even if we are killed.
        heard = self._hear is not None
        child = subprocess.Popen(
            command, env=self.environment, start_new_session=True,
            preexec_fn=partial(die_with, os.getpid()),
            stdout=subprocess.PIPE if heard else None, stderr=subprocess.STDOUT if heard else None)
        name = name or f'{node} {len(self._children)}'
        self._children[name] = child
        if self._hear is not None and child.stdout is not None:
            Thread(target=_listen, args=(name, child.stdout, self._hear), daemon=True).start()
        return child

    def end(self, child: subprocess.Popen[bytes], patience: float) -> None:
        """Ask a child to end, and wait while it finishes its work [s].

        Raises:
            LiveError: it takes longer.
        """
        child.terminate()
        try:
            child.wait(patience)
        except subprocess.TimeoutExpired:
            raise LiveError(f'a process did not end within {patience:g} s') from None

    def check(self) -> None:
        """Raise a LiveError if a child has ended with an error."""
        for node, child in self._children.items():
            if child.poll() not in (None, 0):
                raise LiveError(f'{node} ended with exit status {child.returncode}')


def _listen(name: str, output: IO[bytes], hear: Callable[[str, str], object]) -> None:
    """Hand a process's lines on until it ends."""
    for line in output:
        hear(name, line.decode(errors='replace').rstrip('\n'))


def ros_arguments(
    files: Sequence[Path] = (), values: Mapping[str, object] | None = None,
    remap: Mapping[str, str] | None = None,
) -> list[str]:
    """Return a node's command line after its executable; arguments as in `Processes.start`."""
    arguments = ['--ros-args']
    for file in files:
        arguments += ['--params-file', str(file)]
    for key, value in (values or {}).items():
        arguments += ['-p', f'{key}:={_yaml(value)}']
    for key, target in (remap or {}).items():
        arguments += ['-r', f'{key}:={target}']
    return arguments


def _yaml(value: object) -> str:
    if isinstance(value, (list, tuple)):
        # Quoted, as a name within a list may have a colon.
        return '[' + ', '.join(
            json.dumps(item) if isinstance(item, str) else _yaml(item) for item in value) + ']'
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)


def die_with(parent: int) -> None:
    """Have the system kill this process when its parent ends."""
    ctypes.CDLL(None).prctl(_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != parent:  # it died before it could be asked for the signal
        os._exit(1)


def cpu_seconds(pid: int) -> float:
    """Return the processor time a process has used [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
