"""A camera that looks at an arm, for tests of what it sees."""

from __future__ import annotations

import numpy as np

from redundant_planner.core.obstacles.obstacle import SHAPES
from redundant_planner.perception.cloud_filter import SensorPose
from redundant_planner.perception.depth_camera import arm_bodies, Bodies, DepthCamera, together
from redundant_planner.perception.posture_buffer import Fit, Posture

CAMERA = DepthCamera(160, 120, 1.2, 5.0)


def looking(origin, at) -> SensorPose:
    """A camera at a point that looks at another one, upright."""
    origin, at = np.array(origin, float), np.array(at, float)
    z = (at - origin) / np.linalg.norm(at - origin)
    x = np.cross(z, [0.0, 0.0, 1.0] if abs(z[2]) < 0.99 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    return SensorPose(origin, np.column_stack([x, np.cross(z, x), z]), True)


def still(q, speed=None) -> Posture:
    q = np.array(q, float)
    return Posture(Fit.KNOWN, q, np.zeros(len(q)) if speed is None else speed, 0.0)


def body(shape, center, half_extents, rotation=None) -> Bodies:
    return Bodies(np.array([SHAPES.index(shape)]), np.array([center], float),
                  np.eye(3)[None].copy() if rotation is None else rotation[None].copy(),
                  np.array([half_extents], float))


def arm_of(robot, q) -> Bodies:
    arm = robot.kinematics(q)
    return arm_bodies(arm.segment_start, arm.segment_end,
                      np.array([capsule.radius for capsule in robot.capsules]))


def seen(pose, bodies, camera=CAMERA, random=None) -> np.ndarray:
    """What a camera sees, (3, n) in its own frame."""
    points = camera.points(pose.origin, pose.axes, bodies, random)
    return np.ascontiguousarray(points.reshape(-1, 3).T)


def in_base(points, pose) -> np.ndarray:
    """Points (3, n) of a camera as (m, 3) in the base frame, without those that are NaN."""
    found = points.T @ pose.axes.T + pose.origin
    return found[np.isfinite(found).all(axis=1)]


def distances_to(own, points, radius) -> np.ndarray:
    """How far points (k, 3) are from an arm whose capsules are so thick, by NumPy."""
    result = np.full(len(points), np.inf)
    for start, end, r in zip(own.start, own.end, radius):
        axis = end - start
        t = np.clip((points - start) @ axis / max(axis @ axis, 1e-300), 0.0, 1.0)
        nearest = start + t[:, None] * axis
        result = np.minimum(result, np.linalg.norm(points - nearest, axis=1) - r)
    return result


__all__ = ['CAMERA', 'arm_of', 'body', 'distances_to', 'in_base', 'looking', 'seen', 'still',
           'together']
