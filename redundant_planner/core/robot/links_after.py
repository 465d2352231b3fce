"""The links after a motion of the joints, from the screws at the posture before it.

By the product of exponentials: joint j moves all that it carries by exp(ŝ_j Δq_j) along its screw
s_j of now, after the joints beyond it have moved. In a tree only those on the same branch count.
"""

from __future__ import annotations

import math

import numpy as np

from redundant_planner.core.kernels import compiled, kernel, Matrix, OutMatrix, OutVector, Vector
from redundant_planner.core.robot.kinematics import Links, new_places

# Angles below this are none: the limit is exact to round-off [rad].
_SMALL_ANGLE = 1e-5


@kernel
def _carry(
    rotation: Matrix, position: Vector, screws: Matrix, joint: int, carried: OutMatrix,
) -> None:
    """Write a joint's screw (6,) once it has been carried along: [R v + p × R w; R w]."""
    for axis in range(3):
        carried[axis, joint] = carried[axis + 3, joint] = 0.0
        for k in range(3):
            carried[axis, joint] += rotation[axis, k] * screws[k, joint]
            carried[axis + 3, joint] += rotation[axis, k] * screws[k + 3, joint]
    x, y, z = position
    a, b, c = carried[3:, joint]
    carried[0, joint] += y * c - z * b
    carried[1, joint] += z * a - x * c
    carried[2, joint] += x * b - y * a


@kernel
def _go_on(
    rotation: OutMatrix, position: OutVector, screws: Matrix, joint: int, moved: float,
) -> None:
    """Multiply a rotation and a position by exp(ŝ Δq) of the next joint, in place.

    exp(ŝ θ) turns by I + sin θ [w] + (1 − cos θ) [w]² and shifts by
    (θ I + (1 − cos θ) [w] + (θ − sin θ) [w]²) v; w is a unit vector, or 0 of a prismatic joint.
    """
    v1, v2, v3, a, b, c = screws[:, joint]
    if abs(moved) < _SMALL_ANGLE:
        sine, versine, rest = moved, 0.5 * moved * moved, 0.0
    else:
        sine, versine, rest = math.sin(moved), 1.0 - math.cos(moved), moved - math.sin(moved)
    aa, bb, cc, ab, ac, bc = -b * b - c * c, -a * a - c * c, -a * a - b * b, a * b, a * c, b * c
    turn = np.array((
        (1.0 + versine * aa, versine * ab - sine * c, versine * ac + sine * b),
        (versine * ab + sine * c, 1.0 + versine * bb, versine * bc - sine * a),
        (versine * ac - sine * b, versine * bc + sine * a, 1.0 + versine * cc)))
    shift = np.array((
        moved * v1 + versine * (b * v3 - c * v2) + rest * (aa * v1 + ab * v2 + ac * v3),
        moved * v2 + versine * (c * v1 - a * v3) + rest * (ab * v1 + bb * v2 + bc * v3),
        moved * v3 + versine * (a * v2 - b * v1) + rest * (ac * v1 + bc * v2 + cc * v3)))
    row = np.empty(3)
    for axis in range(3):
        for k in range(3):
            row[k] = 0.0
            position[axis] += rotation[axis, k] * shift[k]
            for other in range(3):
                row[k] += rotation[axis, other] * turn[other, k]
        rotation[axis] = row


@compiled
def links_after(links: Links, motion: Vector) -> Links:
    """Return the links after the joints have moved by a motion (n,) [rad, m], exactly."""
    n, count = len(motion), len(links.start)
    start, end, screws = links.start.copy(), links.end.copy(), np.empty((6, n))
    last = np.full(count, -1)
    for link in range(count):
        for j in range(n):
            if links.supports[link, j] != 0.0:
                last[link] = j
    carried = new_places(n)  # of what each joint carries; the base carries what stays
    for j in range(n):
        rotation, position = carried.rotation[j + 1], carried.position[j + 1]
        rotation[:] = carried.rotation[links.parents[j]]
        position[:] = carried.position[links.parents[j]]
        _carry(rotation, position, links.joint_screws, j, screws)
        _go_on(rotation, position, links.joint_screws, j, motion[j])
        for link in range(count):
            if last[link] == j:
                for axis in range(3):
                    start[link, axis] = end[link, axis] = position[axis]
                    for k in range(3):
                        start[link, axis] += rotation[axis, k] * links.start[link, k]
                        end[link, axis] += rotation[axis, k] * links.end[link, k]
    return Links(start, end, screws, links.supports, links.parents)
