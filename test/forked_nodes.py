"""The package's nodes as processes that are forked from an interpreter which knows them already.

A node of its own interpreter takes two seconds of processor time to import what it needs. Tests
start a hundred.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import importlib
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import signal
import subprocess
import sys

from redundant_planner.nodes.child_processes import die_with, Processes, ros_arguments

FORKS = get_context('forkserver')
# Nodes that only tests have.
_OF_TESTS = ('ros2_control_stand_in', 'scene_stand_in')
FORKS.set_forkserver_preload([
    __name__, *_OF_TESTS, *(f'redundant_planner.nodes.{node}' for node in (
        'planner_node', 'fake_hardware_node', 'scenario_player', 'cloud_obstacles',
        'planning_scene_obstacles', 'depth_camera', 'mujoco_hardware_node'))])


class ForkedProcesses(Processes):
    """Starts nodes as `Processes` does, but faster."""

    def start(
        self, node: str | Path, files: Sequence[Path] = (),
        values: Mapping[str, object] | None = None, remap: Mapping[str, str] | None = None,
        name: str = '', options: Sequence[str] = (),
    ) -> Forked | subprocess.Popen[bytes]:
        """Start a node of this package or of its tests; arguments as in `Processes.start`."""
        if isinstance(node, Path):  # a script, which gets an interpreter of its own
            return super().start(node, files, values, remap, name, options)
        child = Forked(node, [*options, *ros_arguments(files, values, remap)],
                       self.environment)
        self._children[name or f'{node} {len(self._children)}'] = child
        return child


class Forked:
    """One such node, with the methods of a Popen."""

    def __init__(self, node: str, arguments: Sequence[str], environment: Mapping[str, str],
                 stderr: Path | None = None) -> None:
        """Start it; it writes its errors to a file if one is given."""
        self._process: BaseProcess = FORKS.Process(
            target=_run, args=(node, list(arguments), dict(environment), stderr))
        self._process.start()
        self.pid = self._process.pid

    @property
    def returncode(self) -> int | None:
        """Its exit status, None as long as it lives."""
        return self._process.exitcode

    def poll(self) -> int | None:
        """Return its exit status, None as long as it lives."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; return its exit status."""
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout)
        return self._process.exitcode

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it."""
        self.send_signal(signal.SIGKILL)


def _run(node: str, arguments: list[str], environment: dict[str, str], stderr: Path | None):
    die_with(os.getppid())
    os.setsid()
    os.environ.clear()
    os.environ.update(environment)
    if stderr is not None:
        os.dup2(os.open(stderr, os.O_WRONLY | os.O_CREAT), 2)
    sys.argv = [node, *arguments]
    module = node if node in _OF_TESTS else f'redundant_planner.nodes.{node}'
    sys.exit(importlib.import_module(module).main())
