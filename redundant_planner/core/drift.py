"""The reference pose: where the tip would be had every commanded twist been followed exactly.

Integrating q̇ drifts (the paper says so in §1 and leaves it). The reference integrates the twist
on SE(3) instead, and the error of the measured pose against it is fed back into ẋ.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin

Array = npt.NDArray[np.float64]


class Pose(NamedTuple):
    """A tip pose in the base frame.

    Attributes:
        position: (3,) [m].
        rotation: (3, 3) tip axes in the base frame.
    """

    position: Array
    rotation: Array


def integrate(pose: Pose, twist: Array, dt: float, command_frame: str) -> Pose:
    """Return the pose after a constant twist has acted for `dt`, exactly.

    A twist in base axes is the tip point's velocity and the angular velocity, so position and
    orientation integrate separately; a twist in tool axes turns with the tool, a screw motion.

    Args:
        pose: where it starts.
        twist: (6,) [m/s, rad/s] of the tip point, in `command_frame` axes.
        dt: [s].
        command_frame: 'base' or 'tool'.
    """
    if command_frame == 'tool':
        screw = pin.exp6(twist * dt)
        return Pose(pose.position + pose.rotation @ screw.translation,
                    pose.rotation @ screw.rotation)
    rotation = pose.rotation
    if twist[3:].any():
        rotation = pin.exp3(twist[3:] * dt) @ rotation
    return Pose(pose.position + twist[:3] * dt, rotation)


def turned(twist: Array, rotation: Array) -> Array:
    """Return a twist (6,) in the axes that `rotation` (3, 3) takes its own to."""
    return np.concatenate((rotation @ twist[:3], rotation @ twist[3:]))


def pose_error(reference: Pose, actual: Pose, command_frame: str) -> Array:
    """Return the displacement (6,) [m, rad] from `actual` to `reference`, in command axes.

    Position and orientation errors are separate vectors: the difference of positions, and the
    rotation vector of the remaining rotation.
    """
    displacement = reference.position - actual.position
    rotation = pin.log3(reference.rotation @ actual.rotation.T)
    if command_frame == 'tool':
        displacement, rotation = actual.rotation.T @ displacement, actual.rotation.T @ rotation
    return np.concatenate((displacement, rotation))


def displaced(pose: Pose, error: Array, command_frame: str) -> Pose:
    """Return the pose whose `pose_error` against `pose` is `error`."""
    displacement, rotation = error[:3], error[3:]
    if command_frame == 'tool':
        displacement, rotation = pose.rotation @ displacement, pose.rotation @ rotation
    turned = pin.exp3(rotation) @ pose.rotation if rotation.any() else pose.rotation
    return Pose(pose.position + displacement, turned)


def bounded(error: Array, distance: float, angle: float) -> Array:
    """Return the error (6,) with its linear and angular parts no longer than the caps.

    An error within both is returned itself.

    Args:
        error: (6,) from `pose_error` [m, rad].
        distance: cap of the linear part [m].
        angle: cap of the angular part [rad].
    """
    return _capped(error, distance, angle)


def feedback(error: Array, gain: float, speed: float, angular_speed: float) -> Array:
    """Return the twist (6,) that takes the error back at `gain`, never faster than the caps.

    Args:
        error: (6,) from `pose_error` [m, rad].
        gain: [1/s].
        speed: cap of the linear part [m/s].
        angular_speed: cap of the angular part [rad/s].
    """
    return _capped(gain * error, speed, angular_speed)


def _capped(vector: Array, linear: float, angular: float) -> Array:
    """Return the vector with both parts capped; the very same array where neither is."""
    sizes = (math.sqrt(vector[:3] @ vector[:3]), math.sqrt(vector[3:] @ vector[3:]))
    if sizes[0] <= linear and sizes[1] <= angular:
        return vector
    result = vector.copy()
    for part, size, cap in zip((result[:3], result[3:]), sizes, (linear, angular)):
        if size > cap:
            part *= cap / size
    return result
