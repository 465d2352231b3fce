"""ROS messages to core types and back; what may be wrong in a message is caught here."""

from __future__ import annotations

from collections.abc import Sequence

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Twist
import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.errors import known, StateError
from redundant_planner.core.horizon import Preview
from redundant_planner.core.obstacles import Obstacle

Array = npt.NDArray[np.float64]

NANOSECONDS = 1_000_000_000


def seconds_of(stamp: Time | Duration) -> float:
    """Return a stamp or duration in seconds."""
    return float(stamp.sec + stamp.nanosec / NANOSECONDS)


def twist_from_message(message: Twist) -> Array:
    """Return (6,) [vx vy vz wx wy wz].

    Raises:
        StateError: an entry is not finite.
    """
    linear, angular = message.linear, message.angular
    twist = np.array([linear.x, linear.y, linear.z, angular.x, angular.y, angular.z])
    if not np.isfinite(twist).all():
        raise StateError(f'twist is {twist.tolist()}; all six entries must be finite')
    return twist


def twist_to_message(twist: npt.ArrayLike) -> Twist:
    """Return a Twist from (6,) [vx vy vz wx wy wz]."""
    message = Twist()
    values = np.asarray(twist, dtype=float).tolist()
    message.linear.x, message.linear.y, message.linear.z = values[:3]
    message.angular.x, message.angular.y, message.angular.z = values[3:]
    return message


def preview_from_message(message: MultiDOFJointTrajectory) -> Preview:
    """Return the twists ahead; each point has its time and one velocity.

    Raises:
        StateError: a point has no or several velocities, or the numbers make no preview.
    """
    for i, point in enumerate(message.points):
        if len(point.velocities) != 1:
            raise StateError(f'point {i} of the preview has {len(point.velocities)} velocities; '
                             'it takes one, of the tip')
    times = [seconds_of(point.time_from_start) for point in message.points]
    twists = [twist_from_message(p.velocities[0]) for p in message.points]
    return Preview(np.array(times), np.array(twists).reshape(-1, 6))


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
    """Return the positions (n,) of the named joints, whatever their order in the message.

    Joints that are not asked for are ignored.

    Raises:
        StateError: a joint is missing or appears twice, lengths differ, or a value is not finite.
    """
    return _values_of(message, joint_names, message.position, 'position')


def velocities_from_message(message: JointState, joint_names: Sequence[str]) -> Array:
    """Return the velocities (n,) of the named joints; errors as `positions_from_message`."""
    return _values_of(message, joint_names, message.velocity, 'velocity')


def _values_of(
    message: JointState, joint_names: Sequence[str], values: Sequence[float], field: str,
) -> Array:
    names = message.name
    if len(values) != len(names):
        raise StateError(f'{len(names)} joint names came with {len(values)} {field} values')
    index = {name: i for i, name in enumerate(names)}
    if len(index) != len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise StateError(f'joint names appear twice: {known(twice)}')
    missing = [name for name in joint_names if name not in index]
    if missing:
        raise StateError(f'joints are missing: {known(missing)}; the message has {known(names)}')
    result = np.array([values[index[name]] for name in joint_names])
    if not np.isfinite(result).all():
        name = joint_names[int(np.argmin(np.isfinite(result)))]
        raise StateError(f"{field} of joint '{name}' is {values[index[name]]}")
    return result


def markers_of(obstacles: Sequence[Obstacle], frame: str) -> MarkerArray:
    """Return the obstacles as SPHERE markers, numbered in their order."""
    array = MarkerArray()
    for i, obstacle in enumerate(obstacles):
        marker = Marker(ns=obstacle.name, id=i, type=Marker.SPHERE, action=Marker.ADD)
        marker.header.frame_id = frame
        position, quaternion, scale = marker.pose.position, marker.pose.orientation, marker.scale
        position.x, position.y, position.z = obstacle.center.tolist()
        quaternion.x, quaternion.y, quaternion.z, quaternion.w = obstacle.orientation.tolist()
        scale.x, scale.y, scale.z = (2.0 * obstacle.semi_axes).tolist()
        marker.color.r, marker.color.g, marker.color.b, marker.color.a = 0.85, 0.35, 0.2, 0.8
        array.markers.append(marker)
    return array
