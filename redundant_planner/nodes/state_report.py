"""What the planner says about itself: /diagnostics, and ~/markers for RViz."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point
import numpy as np
import numpy.typing as npt
import pinocchio as pin
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.obstacles.clearance import surface_point
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.planner import Nearest, StepResult
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# Obstacles shown in RViz, the nearest to the tip; the topic obstacles shows them all.
_SHOWN = 50
# Tick times that are kept for a report.
_TICKS = 5000
# Points of the reference path, one per message.
_PATH = 200


@dataclass
class LoopState:
    """The loop as it is now; the node keeps it up to date.

    Attributes:
        hold: why the arm is at rest or being brought to rest, empty while the planner moves it.
        fault: whether `hold` is a fault, rather than a wish.
        trouble: what is wrong with the inputs, without holding the arm.
        result: of the last tick, None before the first.
        tick_times: of the ticks since the last report [s].
        overruns: ticks that took longer than the period, since the start.
        faults, last_fault: exceptions that nobody foresaw, since the start, and the latest one.
        last_word: what the process does that stops the arm should this one die.
        joint_state_age, command_age, obstacle_age: [s], infinite before the first message.
    """

    hold: str = 'waiting for joint_states'
    fault: bool = False
    trouble: str = ''
    result: StepResult | None = None
    tick_times: deque[float] = field(default_factory=lambda: deque(maxlen=_TICKS))
    overruns: int = 0
    faults: int = 0
    last_fault: str = ''
    last_word: str = 'starting'
    joint_state_age: float = np.inf
    command_age: float = np.inf
    obstacle_age: float = np.inf


def status_of(
    name: str, robot: Robot, state: LoopState, q: Array | None, method: str, obstacles: int,
) -> DiagnosticStatus:
    """Return one entry of /diagnostics.

    Args:
        name: of the node.
        robot: the arm.
        state: of the loop.
        q: (n,) latest measurement, None without one.
        method: in use.
        obstacles: how many are known.
    """
    status = DiagnosticStatus(name=f'{name}: planner', hardware_id=robot.name)
    result = state.result
    reason = result.reason if result is not None else ''
    if state.hold:
        status.level = DiagnosticStatus.ERROR if state.fault else DiagnosticStatus.WARN
        status.message = state.hold
    elif state.trouble or reason:
        status.level, status.message = DiagnosticStatus.WARN, state.trouble or reason
    else:
        status.level, status.message = DiagnosticStatus.OK, 'planning'
    values = {
        'method': method,
        'limited by': reason,
        'obstacles': str(obstacles),
        'tick time, median [us]': _number(1e6, np.median, state.tick_times),
        'tick time, longest [us]': _number(1e6, np.max, state.tick_times),
        'overruns': str(state.overruns),
        'faults': str(state.faults),
        'last fault': state.last_fault,
        'last word': state.last_word,
        'age of joint_states [s]': f'{state.joint_state_age:.3f}',
        'age of cmd_vel [s]': f'{state.command_age:.3f}',
        'age of obstacles [s]': f'{state.obstacle_age:.3f}',
    }
    if result is not None:
        values |= {
            'factor k': f'{result.factor:.6g}',
            'twist scale s': f'{result.scale:.4f}',
            'stage': result.stage.name,
            'manipulability': f'{result.manipulability:.6g}',
            'path error [m]': f'{float(np.linalg.norm(result.path_error[:3])):.6f}',
            'nearest pair': _pair(result.nearest),
            'nearest distance [m]': (
                f'{result.nearest.distance:.4f}' if result.nearest else 'inf'),
        }
    if q is not None:
        room = np.minimum(robot.position_max - q, q - robot.position_min)
        least = int(room.argmin())
        values['smallest limit margin'] = f'{room[least]:.4f} ({robot.joint_names[least]})'
    status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
    return status


def _number(unit: float, statistic: object, values: Collection[float]) -> str:
    if not values:
        return ''
    return f'{unit * float(statistic(list(values))):.0f}'  # type: ignore[operator]


def _pair(nearest: Nearest | None) -> str:
    return f'{nearest.link} to {nearest.obstacle}' if nearest else ''


def diagnostics(status: DiagnosticStatus, stamp: object) -> DiagnosticArray:
    """Return the message that holds one status."""
    message = DiagnosticArray(status=[status])
    message.header.stamp = stamp
    return message


class RobotMarkers:
    """Draws the planner's view of the world; the messages' parts are made once."""

    def __init__(self, robot: Robot) -> None:
        """Prepare for a robot."""
        self._robot = robot
        self._path: deque[Point] = deque(maxlen=_PATH)
        self._shafts = [self._marker('link', 2 * i, Marker.CYLINDER, _BLUE)
                        for i in range(len(robot.capsules))]
        self._caps = [self._marker('link', 2 * i + 1, Marker.SPHERE_LIST, _BLUE)
                      for i in range(len(robot.capsules))]
        for capsule, shaft, cap in zip(robot.capsules, self._shafts, self._caps):
            diameter = max(2.0 * capsule.radius, 0.01)
            shaft.scale.x = shaft.scale.y = diameter
            shaft.scale.z = max(float(np.linalg.norm(capsule.end - capsule.start)), 1e-6)
            cap.scale.x = cap.scale.y = cap.scale.z = diameter
        self._line = self._marker('nearest', 0, Marker.LINE_LIST, _RED)
        self._line.scale.x = 0.005
        self._track = self._marker('reference', 0, Marker.LINE_STRIP, _GREEN)
        self._track.scale.x = 0.005

    def message(
        self, arm: Kinematics, scene: Scene, nearest: Nearest | None, reference: Array | None,
    ) -> MarkerArray:
        """Return the picture at one posture.

        Args:
            arm: the posture.
            scene: the obstacles.
            nearest: the nearest pair, None without obstacles.
            reference: (3,) where the tip should be, None while it need not be anywhere [m].
        """
        for start, end, shaft, cap in zip(
                arm.segment_start, arm.segment_end, self._shafts, self._caps):
            _place(shaft, 0.5 * (start + end), _upright_to(end - start))
            cap.points = [_point(start), _point(end)]
        self._line.points = []
        if nearest is not None:
            link = [c.name for c in self._robot.capsules].index(nearest.link)
            here, there = surface_point(
                scene, scene.names.index(nearest.obstacle), arm.segment_start[link],
                arm.segment_end[link])
            self._line.points = [_point(here), _point(there)]
        if reference is not None:
            self._path.append(_point(reference))
        self._track.points = list(self._path)
        return MarkerArray(markers=[
            Marker(ns='obstacle', action=Marker.DELETEALL), *self._shafts, *self._caps,
            self._line, self._track, *self._obstacles(arm, scene)])

    def _obstacles(self, arm: Kinematics, scene: Scene) -> list[Marker]:
        away = np.linalg.norm(scene.centers - arm.tip_position, axis=1)
        markers = []
        for i in np.argsort(away)[:_SHOWN].tolist():
            marker = self._marker('obstacle', i, Marker.SPHERE, _RED)
            _place(marker, scene.centers[i], pin.Quaternion(scene.rotations[i]).coeffs())
            marker.scale.x, marker.scale.y, marker.scale.z = (2.0 * scene.semi_axes[i]).tolist()
            markers.append(marker)
        return markers

    def _marker(
        self, namespace: str, number: int, kind: int, color: Sequence[float],
    ) -> Marker:
        marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD)
        marker.header.frame_id = self._robot.base_frame
        marker.pose.orientation.w = 1.0
        marker.color.r, marker.color.g, marker.color.b, marker.color.a = color
        return marker


_BLUE, _RED, _GREEN = (0.11, 0.21, 0.34, 0.5), (0.78, 0.33, 0.24, 0.6), (0.16, 0.62, 0.56, 1.0)


def _point(position: Array) -> Point:
    x, y, z = position.tolist()
    return Point(x=x, y=y, z=z)


def _place(marker: Marker, position: Array, quaternion: Array) -> None:
    p, o = marker.pose.position, marker.pose.orientation
    p.x, p.y, p.z = position.tolist()
    o.x, o.y, o.z, o.w = quaternion.tolist()


def _upright_to(direction: Array) -> Array:
    """Return the quaternion (4,) that turns the z axis into a direction."""
    if not direction.any():
        return np.array([0.0, 0.0, 0.0, 1.0])
    return pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction).coeffs()
