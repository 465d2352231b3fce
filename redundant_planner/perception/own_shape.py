"""The arm as a depth camera may see it: its capsules, thick enough for what is not known exactly.

A point in one of them may be the arm itself and says nothing about obstacles. How thick: by a
margin for the camera's noise and calibration, and by how far the link moves within the time by
which the stamps of camera and joints may be wrong.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, kernel, Matrix, OutMatrix, Vector
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# An arm that can reach further has a joint without limits [m].
_FARTHEST = 100.0


class OwnShape(NamedTuple):
    """The arm at one posture.

    Attributes:
        start, end: (c, 3) segments of the capsules in the base frame [m].
        radius: (c,) of the capsules [m].
        thick: (c,) radii within which a point may be of the arm [m].
    """

    start: Matrix
    end: Matrix
    radius: Vector
    thick: Vector


def own_shape(
    robot: Robot, q: Array, speed: Array, margin: float, uncertainty: float,
) -> OwnShape:
    """Return the arm as it was at a stamp.

    Args:
        robot: the arm.
        q: (n,) posture at the stamp [rad, m].
        speed: (n,) how fast the joints moved [rad/s, m/s].
        margin: that all capsules get [m].
        uncertainty: by which the stamp may be wrong [s].
    """
    arm = robot.kinematics(q)
    radius = np.array([capsule.radius for capsule in robot.capsules])
    moved = robot.lever_arm_bounds @ np.abs(speed) * uncertainty
    return OwnShape(arm.segment_start, arm.segment_end, radius, radius + margin + moved)


def reach_of(robot: Robot) -> tuple[Array, float]:
    """Return the centre (3,) and radius of a ball that holds the arm at every posture [m].

    It lies around the first joint. No point is further from it than all lengths of the chain
    after it.
    """
    model = robot.model
    prismatic = np.array([not joint.shortname().startswith('JointModelR')
                          for joint in list(model.joints)[1:]])
    stroke = np.where(prismatic, np.maximum(
        np.abs(robot.position_min), np.abs(robot.position_max)), 0.0)
    lengths = [float(np.linalg.norm(placement.translation))
               for placement in list(model.jointPlacements)[2:]]
    # From the first joint's place to the frame of every joint.
    to_joint = np.cumsum(np.array([0.0, *lengths]) + stroke)
    reach = float(to_joint[-1])
    for capsule, joint, ends in zip(
            robot.capsules, robot.chain.capsule_joint, robot.chain.capsule_ends):
        if joint > 0:
            reach = max(reach, to_joint[joint - 1] + capsule.radius
                        + float(np.linalg.norm(ends, axis=0).max()))
    return np.array(model.jointPlacements[1].translation), min(reach, _FARTHEST)


@kernel
def _squared_distance(own: OwnShape, link: int, x: float, y: float, z: float) -> float:
    """Return the squared distance of a point from a capsule's segment [m²]."""
    ax, ay, az = own.start[link, 0], own.start[link, 1], own.start[link, 2]
    ux, uy, uz = own.end[link, 0] - ax, own.end[link, 1] - ay, own.end[link, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    length = ux * ux + uy * uy + uz * uz
    t = 0.0
    if length > 0.0:
        t = min(max((px * ux + py * uy + pz * uz) / length, 0.0), 1.0)
    px, py, pz = px - t * ux, py - t * uy, pz - t * uz
    return px * px + py * py + pz * pz


@compiled
def keep_outside(points: OutMatrix, own: OwnShape) -> int:
    """Move the points (3, n) that cannot be of the arm to the front; return how many there are.

    A box around the whole arm and a ball around each link tell most of them at once.
    """
    links = len(own.radius)
    ball = np.empty((links, 4))  # centre, and squared radius
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for link in range(links):
        half = 0.0
        for axis in range(3):
            a, b = own.start[link, axis], own.end[link, axis]
            ball[link, axis] = 0.5 * (a + b)
            half += 0.25 * (b - a) * (b - a)
            low[axis] = min(low[axis], min(a, b) - own.thick[link])
            high[axis] = max(high[axis], max(a, b) + own.thick[link])
        ball[link, 3] = (math.sqrt(half) + own.thick[link]) ** 2
    m = 0
    for i in range(points.shape[1]):
        x, y, z = points[0, i], points[1, i], points[2, i]
        free = True
        if (low[0] <= x <= high[0] and low[1] <= y <= high[1] and low[2] <= z <= high[2]):
            for link in range(links):
                dx, dy, dz = x - ball[link, 0], y - ball[link, 1], z - ball[link, 2]
                if dx * dx + dy * dy + dz * dz <= ball[link, 3] and _squared_distance(
                        own, link, x, y, z) <= own.thick[link] * own.thick[link]:
                    free = False
                    break
        points[0, m], points[1, m], points[2, m] = x, y, z
        m += free
    return m


@compiled
def surface_distances(points: Matrix, own: OwnShape) -> Array:
    """Return how far points (k, 3) are from the arm, (k, 2) [m].

    Returns:
        From the capsules themselves, and from the thick ones; negative inside.
    """
    distances = np.full((len(points), 2), np.inf)
    for i in range(len(points)):
        for link in range(len(own.radius)):
            away = math.sqrt(_squared_distance(
                own, link, points[i, 0], points[i, 1], points[i, 2]))
            distances[i, 0] = min(distances[i, 0], away - own.radius[link])
            distances[i, 1] = min(distances[i, 1], away - own.thick[link])
    return distances
