"""ROS messages to core types and back; refuses bad numbers, joints and lengths."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import math
import struct

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Twist
from nav_msgs.msg import Odometry
import numpy as np
import numpy.typing as npt
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.errors import known, StateError
from redundant_planner.core.horizon.preview import Preview
from redundant_planner.core.obstacles.obstacle import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    HALF_SPACE,
    Obstacle,
)
from redundant_planner.io.cdr import byte_order, ENCAPSULATION, header_of
from redundant_planner.io.mobile_base import BASE_JOINTS, ODOM, own_twist
from redundant_planner.io.plausible import FASTEST, LARGEST

Array = npt.NDArray[np.float64]

NANOSECONDS = 1_000_000_000
# How far the length of a quaternion may be from 1, and how far a base may lean.
_UNIT, _UPRIGHT = 0.01, 0.02

_MARKER_TYPES = {ELLIPSOID: Marker.SPHERE, BOX: Marker.CUBE, CYLINDER: Marker.CYLINDER,
                 CAPSULE: Marker.LINE_LIST}


def seconds_of(stamp: Time | Duration) -> float:
    """Return a stamp or duration in seconds."""
    return float(stamp.sec + stamp.nanosec / NANOSECONDS)


def checked_twist(twist: Array) -> Array:
    """Return a twist (6,) within the bounds.

    Raises:
        StateError: an entry is not finite or beyond `FASTEST`.
    """
    if not (np.abs(twist) <= FASTEST).all():
        raise StateError(f'twist is {twist.tolist()}; all six entries must be finite, up to '
                         f'{FASTEST:g} m/s and rad/s')
    return twist


def base_states(raw: bytes) -> bytes:
    """Return a serialised Odometry as a JointState of the base's joints.

    Raises:
        StateError: it is none, has numbers that are not finite, or the base leans.
    """
    try:
        message = deserialize_message(bytes(raw), Odometry)
    except Exception as error:
        raise StateError(f'it cannot be read: {error}') from None
    position, turned = message.pose.pose.position, message.pose.pose.orientation
    x, y, z, w = turned.x, turned.y, turned.z, turned.w
    if not np.isfinite((position.x, position.y, x, y, z, w)).all():
        raise StateError('its pose has numbers that are not finite')
    if not abs(np.linalg.norm((x, y, z, w)) - 1.0) < _UNIT or abs(x) + abs(y) > _UPRIGHT:
        raise StateError(f'its orientation is {(x, y, z, w)}; it takes a unit quaternion about z')
    yaw = 2.0 * math.atan2(z, w)
    states = JointState(name=list(BASE_JOINTS), position=[position.x, position.y, yaw])
    states.header.stamp = message.header.stamp
    return bytes(serialize_message(states))


def odometry_of(stamp_ns: int, q: Array, dq: Array) -> Odometry:
    """Return where a base is and how it moves, from positions and rates (3,) of its joints."""
    message = Odometry(child_frame_id='base')
    message.header.frame_id = ODOM
    message.header.stamp = Time(
        sec=stamp_ns // NANOSECONDS, nanosec=stamp_ns % NANOSECONDS)
    pose, twist = message.pose.pose, message.twist.twist
    x, y, yaw = map(float, q)
    pose.position.x, pose.position.y = x, y
    pose.orientation.z, pose.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    twist.linear.x, twist.linear.y, twist.angular.z = map(float, own_twist(dq, yaw))
    return message


def twist_from_bytes(raw: bytes) -> Array:
    """Return (6,) [vx vy vz wx wy wz] of a serialised geometry_msgs/Twist.

    Raises:
        StateError: the bytes are no Twist, or `checked_twist`.
    """
    return _twist_at(raw, byte_order(raw), ENCAPSULATION)


def stamped_twist_from_bytes(raw: bytes) -> tuple[float, str, Array]:
    """Return stamp [s], frame and twist (6,) of a serialised geometry_msgs/TwistStamped.

    Raises:
        StateError: the bytes are no TwistStamped, or `checked_twist`.
    """
    order = byte_order(raw)
    stamp, frame, end = header_of(raw, order)
    return stamp, frame, _twist_at(raw, order, ENCAPSULATION + -(-end // 8) * 8)


def _twist_at(raw: bytes, order: str, at: int) -> Array:
    try:
        numbers = struct.unpack_from(f'{order}6d', raw, at)
    except struct.error:
        raise StateError(f'the bytes end within the twist: there are {len(raw)}') from None
    return checked_twist(np.array(numbers))


def twist_to_message(twist: npt.ArrayLike) -> Twist:
    """Return a Twist from (6,) [vx vy vz wx wy wz]."""
    message = Twist()
    values = np.asarray(twist, dtype=float).tolist()
    message.linear.x, message.linear.y, message.linear.z = values[:3]
    message.angular.x, message.angular.y, message.angular.z = values[3:]
    return message


def preview_to_message(preview: Preview) -> MultiDOFJointTrajectory:
    """Return the twists ahead as a message without a stamp."""
    message = MultiDOFJointTrajectory()
    for time, twist in zip(preview.times, preview.twists):
        point = MultiDOFJointTrajectoryPoint(velocities=[twist_to_message(twist)])
        nanoseconds = round(float(time) * NANOSECONDS)
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(
            nanoseconds, NANOSECONDS)
        message.points.append(point)
    return message


def positions_from_message(message: JointState, joint_names: Sequence[str]) -> Array:
    """Return the positions (n,) of the named joints; errors as `values_of`."""
    return values_of(message.name, message.position, joint_names, 'position')


def velocities_from_message(message: JointState, joint_names: Sequence[str]) -> Array:
    """Return the velocities (n,) of the named joints; errors as `values_of`."""
    return values_of(message.name, message.velocity, joint_names, 'velocity')


def values_of(
    names: Sequence[str], values: Sequence[float], joint_names: Sequence[str], field: str,
) -> Array:
    """Return the values (n,) of the named joints, in any order of the message.

    Other joints are ignored.

    Args:
        names, values: of the message.
        joint_names: whose values to return.
        field: the name of the values, for messages.

    Raises:
        StateError: a joint is missing or appears twice, lengths differ, or a value is not finite
            or beyond `LARGEST`.
    """
    if len(values) != len(names):
        raise StateError(f'{len(names)} joint names came with {len(values)} {field} values')
    index = {name: i for i, name in enumerate(names)}
    if len(index) != len(names):
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        raise StateError(f'joint names appear twice: {known(twice)}')
    missing = [name for name in joint_names if name not in index]
    if missing:
        raise StateError(f'joints are missing: {known(missing)}; the message has {known(names)}')
    result = np.array([values[index[name]] for name in joint_names])
    usable = np.abs(result) <= LARGEST
    if not usable.all():
        name = joint_names[int(np.argmin(usable))]
        raise StateError(f"{field} of joint '{name}' is {values[index[name]]}; it must be finite, "
                         f'up to {LARGEST:g}')
    return result


def markers_of(obstacles: Sequence[Obstacle], frame: str) -> MarkerArray:
    """Return the obstacles as markers, numbered in their order; half-spaces have none."""
    array = MarkerArray()
    for i, obstacle in enumerate(obstacles):
        if obstacle.shape != HALF_SPACE:
            marker = marker_of(obstacle, (0.85, 0.35, 0.2, 0.8))
            marker.ns, marker.id, marker.header.frame_id = obstacle.name, i, frame
            array.markers.append(marker)
    return array


def marker_of(obstacle: Obstacle, color: Sequence[float]) -> Marker:
    """Return an obstacle as a marker, of a colour (r g b alpha); a capsule is a line."""
    marker = Marker(type=_MARKER_TYPES[obstacle.shape], action=Marker.ADD)
    position, quaternion, scale = marker.pose.position, marker.pose.orientation, marker.scale
    position.x, position.y, position.z = obstacle.center.tolist()
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = obstacle.orientation.tolist()
    width, scale.y, height = (2.0 * obstacle.half_extents).tolist()
    scale.x, scale.z = width, height
    if obstacle.shape == CAPSULE:
        half = 0.5 * (height - width)
        marker.points = [Point(z=-half), Point(z=half)]
    marker.color.r, marker.color.g, marker.color.b, marker.color.a = color
    return marker
