"""~/markers: the planner's view of the world, for RViz."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from geometry_msgs.msg import Point
import numpy as np
import numpy.typing as npt
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.obstacles.clearance_gradients import surface_point
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.shapes import HALF_SPACE
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.quaternions import quaternion_of
from redundant_planner.core.step_result import Nearest
from redundant_planner.io.marker_shapes import upright_to
from redundant_planner.nodes.messages import marker_of

Array = npt.NDArray[np.float64]

# Obstacles shown in RViz, the nearest to the tip; the topic obstacles shows them all.
_SHOWN = 50
# Points of the reference path, one per message.
_PATH = 200
# Colours: red, green, blue, opacity.
_BLUE, _RED, _GREEN = (0.11, 0.21, 0.34, 0.5), (0.78, 0.33, 0.24, 0.6), (0.16, 0.62, 0.56, 1.0)


class RobotMarkers:
    """Draws arm, obstacles, nearest pair and reference; most message parts are made once."""

    def __init__(self, robot: Robot) -> None:
        """Prepare for a robot."""
        self._frame = robot.base_frame
        self._path: deque[Point] = deque(maxlen=_PATH)
        self._line = self._marker('nearest', 0, Marker.LINE_LIST, _RED)
        self._line.scale.x = 0.005
        self._track = self._marker('reference', 0, Marker.LINE_STRIP, _GREEN)
        self._track.scale.x = 0.005
        self._prepare(robot)

    def _prepare(self, robot: Robot) -> None:
        """Make the markers of an arm's capsules."""
        self._robot = robot
        self._shafts = [self._marker('link', 2 * i, Marker.CYLINDER, _BLUE)
                        for i in range(len(robot.capsules))]
        self._caps = [self._marker('link', 2 * i + 1, Marker.SPHERE_LIST, _BLUE)
                      for i in range(len(robot.capsules))]
        for capsule, shaft, cap in zip(robot.capsules, self._shafts, self._caps):
            diameter = max(2.0 * capsule.radius, 0.01)
            shaft.scale.x = shaft.scale.y = diameter
            shaft.scale.z = max(float(np.linalg.norm(capsule.end - capsule.start)), 1e-6)
            cap.scale.x = cap.scale.y = cap.scale.z = diameter

    def message(
        self, robot: Robot, arm: Kinematics, scene: Scene, nearest: Nearest | None,
        reference: Array | None,
    ) -> MarkerArray:
        """Return the picture at one posture.

        Args:
            robot: the arm, with what it holds.
            arm: the posture.
            scene: the obstacles.
            nearest: the nearest pair, None without obstacles.
            reference: (3,) where the tip should be, None while it need not be anywhere [m].
        """
        if robot is not self._robot:
            self._prepare(robot)
        for start, end, shaft, cap in zip(
                arm.segment_start, arm.segment_end, self._shafts, self._caps):
            _place(shaft, 0.5 * (start + end),
                   quaternion_of(upright_to((end - start)[None])[0]))
            cap.points = [_point(start), _point(end)]
        self._line.points = []
        if nearest is not None:
            links = [i for i, c in enumerate(self._robot.capsules) if c.name == nearest.link]
            # A marker that lists many obstacles gives all of them its name.
            rows = [i for i, name in enumerate(scene.names) if name == nearest.obstacle]
            if links and rows:  # which may be gone since the tick that found them
                here, there = surface_point(
                    scene, np.array(rows), arm.segment_start[links[0]], arm.segment_end[links[0]])
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
        away[scene.shapes == HALF_SPACE] = np.inf
        for i in np.argsort(away)[:_SHOWN].tolist():
            if np.isfinite(away[i]):
                marker = marker_of(scene.obstacle(i), _RED)
                marker.ns, marker.id = 'obstacle', i
                marker.header.frame_id = self._frame
                markers.append(marker)
        return markers

    def _marker(
        self, namespace: str, number: int, kind: int, color: Sequence[float],
    ) -> Marker:
        marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD)
        marker.header.frame_id = self._frame
        marker.pose.orientation.w = 1.0
        marker.color.r, marker.color.g, marker.color.b, marker.color.a = color
        return marker


def _point(position: Array) -> Point:
    x, y, z = position.tolist()
    return Point(x=x, y=y, z=z)


def _place(marker: Marker, position: Array, quaternion: Array) -> None:
    p, o = marker.pose.position, marker.pose.orientation
    p.x, p.y, p.z = position.tolist()
    o.x, o.y, o.z, o.w = quaternion.tolist()
