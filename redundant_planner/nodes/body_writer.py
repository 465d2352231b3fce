"""Writes the bytes of ~/body: the arm's capsules, each a marker that says how fast it moves.

rclpy makes a Python object of every field of every marker: 1 ms for an arm, fifty times a second.
"""

from __future__ import annotations

import itertools
import struct

from geometry_msgs.msg import Point
import numpy as np
import numpy.typing as npt
from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.cdr import ENCAPSULATION
from redundant_planner.io.marker_reader import places_in
from redundant_planner.nodes.messages import NANOSECONDS

Array = npt.NDArray[np.float64]

_COLOR = (0.11, 0.21, 0.34, 0.8)  # red, green, blue, opacity
# Always as long [m/s, rad/s].
_FASTEST = 999.0
_TEXT = 'twist ' + ' '.join(['{:+11.6f}'] * 6)


class BodyWriter:
    """The moving capsules of one arm, with what it holds, as markers.

    The base is none of them: two arms on one base would be in each other's way from the start.

    Each is a LINE_LIST of one line about its middle. They follow a DELETEALL, so that what the
    hand has let go of is gone.
    """

    def __init__(self, robot: Robot, namespace: str) -> None:
        """Lay the message out.

        Args:
            robot: the arm.
            namespace: that the markers' own begin with.
        """
        self.robot = robot
        markers = [Marker(action=Marker.DELETEALL)]
        for i, capsule in enumerate(itertools.compress(robot.capsules, robot.moved)):
            marker = Marker(ns=f'{namespace}/{capsule.name}', id=i, type=Marker.LINE_LIST,
                            points=[Point(), Point()], text=_TEXT.format(*[0.0] * 6))
            marker.header.frame_id = robot.base_frame
            marker.pose.orientation.w = 1.0
            marker.scale.x = 2.0 * capsule.radius
            c = marker.color
            c.r, c.g, c.b, c.a = _COLOR
            markers.append(marker)
        self._bytes = bytearray(serialize_message(MarkerArray(markers=markers)))
        self._places = [
            tuple(ENCAPSULATION + 4 * word for word in found)
            for found in places_in(bytes(self._bytes))[1:]]

    def message(self, stamp_ns: int, arm: Kinematics, dq: Array) -> bytes:
        """Return the serialised message.

        Args:
            stamp_ns: [ns].
            arm: where it is.
            dq: (n,) how fast its joints move [rad/s, m/s].
        """
        moved = self.robot.moved
        start, end = arm.segment_start[moved], arm.segment_end[moved]
        middles, halves = 0.5 * (start + end), 0.5 * (end - start)
        twists = (arm.joint_screws * dq @ self.robot.supports[moved].T).T
        twists[:, :3] += np.cross(twists[:, 3:], middles)
        stamp = divmod(stamp_ns, NANOSECONDS)
        twists = np.clip(twists, -_FASTEST, _FASTEST)
        for (head, pose, points, text), middle, half, twist in zip(
                self._places, middles.tolist(), halves, twists.tolist()):
            struct.pack_into('<iI', self._bytes, head, *stamp)
            struct.pack_into('<3d', self._bytes, pose, *middle)
            struct.pack_into('<6d', self._bytes, points, *(-half).tolist(), *half.tolist())
            said = _TEXT.format(*twist).encode()
            self._bytes[text:text + len(said)] = said
        return bytes(self._bytes)
