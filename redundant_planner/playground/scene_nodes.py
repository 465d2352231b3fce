"""The processes of a scene: a planner and a simulated arm for each arm in it."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from pathlib import Path
import subprocess
import sys
from types import TracebackType

from redundant_planner.core.errors import RobotError
from redundant_planner.io.parameter_files import read_robot_parameters
from redundant_planner.io.resources import panda_urdf, share_directory
from redundant_planner.nodes.child_processes import LiveError, Processes
from redundant_planner.playground.scenes import ArmSetup

PLANNER, ARM = 'planner_node', 'fake_hardware_node'
# How long a planner gets to bring its arm to rest and end [s].
_PATIENCE = 5.0
# Lines of a process that are kept for what is said when it has died.
_LAST_LINES = 5


class SceneNodes:
    """Starts and ends the nodes; none outlives the `with` block."""

    def __init__(self, domain: int, robot_file: Path | None, urdf: str) -> None:
        """Prepare.

        Args:
            domain: ROS domain.
            robot_file: parameter file of the arm; None for the Panda of config/.
            urdf: that replaces the file's; empty for that.
        """
        self._file = robot_file or share_directory() / 'config' / 'robots' / 'panda.yaml'
        self._urdf = urdf if urdf or robot_file else str(panda_urdf() or '')
        if not self._urdf and robot_file is None:
            raise RobotError('no URDF of a Panda on this machine: pip install example-robot-data, '
                             'or name an arm of yours with --robot')
        self._said: dict[str, deque[str]] = {}
        self._processes = Processes(domain, self._hear)
        self._planners: dict[str, subprocess.Popen[bytes]] = {}
        self._arms: dict[str, subprocess.Popen[bytes]] = {}
        self._running: tuple[tuple[Path, str, tuple[Path, ...]], ...] = ()

    def __enter__(self) -> SceneNodes:
        """Return itself; `load` starts what is needed."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End all nodes, the planners first: they bring their arms to rest."""
        try:
            self._end(self._planners)
        finally:
            self._processes.__exit__(kind, error, trace)

    def load(self, arms: Sequence[ArmSetup]) -> bool:
        """Start the nodes of some arms; return whether the planners are new.

        Where the planners are those of the scene before, only the simulated arms begin anew.

        Raises:
            LiveError: a process does not end.
        """
        wanted = tuple((arm.robot_file or self._file, arm.namespace, arm.files) for arm in arms)
        is_new = wanted != self._running
        if is_new:
            self._running = ()
            self._end(self._planners)
        self._end(self._arms)
        for arm in arms:
            files = [arm.robot_file or self._file, *arm.files]
            common: dict[str, object] = {} if arm.robot_file else {'urdf': self._urdf}
            if not common.get('urdf'):
                common = {}
            remap = {'__ns': f'/{arm.namespace}'} if arm.namespace else {}
            start = {'initial_joints': list(arm.start),
                     'initial_positions': list(arm.start.values())} if arm.start else {}
            for kind, node, values in ((self._arms, ARM, {**common, **start}),
                                       (self._planners, PLANNER, common)):
                if node == ARM or is_new:
                    name = f'{arm.namespace or "the"} {node}'
                    kind[arm.namespace] = self._processes.start(
                        node, files, values, remap, name=name)
        self._running = wanted
        return is_new

    def folder_of(self, arm: ArmSetup) -> Path | None:
        """Return the folder of an arm's URDF, for the meshes that it names."""
        file = arm.robot_file or self._file
        if not arm.robot_file and self._urdf:
            return Path(self._urdf).parent
        parameters, _ = read_robot_parameters(file)
        return (file.parent / parameters.urdf).parent if parameters.urdf else None

    def check(self) -> None:
        """Make sure that all run; LiveError with what one said last if it has ended."""
        for kind, children in ((ARM, self._arms), (PLANNER, self._planners)):
            for namespace, child in children.items():
                if child.poll() is not None:
                    last = '\n  '.join(self._said.get(f'{namespace or "the"} {kind}', ()))
                    raise LiveError(f'{kind} ended with exit status {child.returncode}' + (
                        f'; it said last:\n  {last}' if last else ''))

    def _end(self, children: dict[str, subprocess.Popen[bytes]]) -> None:
        for child in children.values():
            child.terminate()
        while children:
            _, child = children.popitem()
            self._processes.end(child, _PATIENCE)

    def _hear(self, name: str, line: str) -> None:
        self._said.setdefault(name, deque(maxlen=_LAST_LINES)).append(line)
        print(line, file=sys.stderr, flush=True)
