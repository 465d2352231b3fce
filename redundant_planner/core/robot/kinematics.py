"""Forward kinematics and Jacobians of a serial chain, at one posture or at several.

Pinocchio reads the robot; where its joints sit in each other's frames comes from its model. The
product of these placements is written here, because a tick that plans needs it at a dozen
postures: calling Pinocchio from Python for each would take longer than all the rest of the tick.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import entry, Indices, kernel, Matrix, OutMatrix, Stack, Vector
from redundant_planner.core.machine_code.packed import Packed

Array = npt.NDArray[np.float64]


class Kinematics(NamedTuple):
    """The arm at one posture; everything is expressed in the base frame.

    Attributes:
        q: (n,) joint positions [rad, m].
        joint_screws: (6, n) [v; w], v taken at the base origin [m/s, rad/s per unit q̇].
        tip_position: (3,) [m].
        tip_rotation: (3, 3) tip axes in the base frame.
        tip_jacobian: (6, n) of the tip point, base axes (LOCAL_WORLD_ALIGNED).
        jacobian: (m, n) the controlled rows, in the command frame: J of the paper.
        segment_start: (c, 3) first ends of the capsules [m].
        segment_end: (c, 3) second ends of the capsules [m].
    """

    q: Vector
    joint_screws: Matrix
    tip_position: Vector
    tip_rotation: Matrix
    tip_jacobian: Matrix
    jacobian: Matrix
    segment_start: Matrix
    segment_end: Matrix


class KinematicsAlong(NamedTuple):
    """The fields of `Kinematics` at N postures: N leads every array."""

    q: Matrix
    joint_screws: Stack
    tip_position: Matrix
    tip_rotation: Stack
    tip_jacobian: Stack
    jacobian: Stack
    segment_start: Stack
    segment_end: Stack


class Links(NamedTuple):
    """The links at one posture, and how the joints move them.

    Attributes:
        start, end: (c, 3) the capsules' segments in the base frame [m].
        joint_screws: (6, n) see `Kinematics`.
        supports: (c, n) 1 where a joint moves a link, else 0.
    """

    start: Matrix
    end: Matrix
    joint_screws: Matrix
    supports: Matrix


class Chain(NamedTuple):
    """What stays the same at every posture.

    Attributes:
        placed: (n, 3, 3) each joint's axes at position 0 in the frame of the joint before.
        offset: (n, 3) its origin there [m].
        motion: (n, 6) [v; w] what the joint does per unit of q̇, in its own frame: v is 0 for a
            revolute joint, w for a prismatic one, and the other is a unit vector.
        tip_joint: number of the joint that carries the tip frame.
        tip_in_joint: (3, 3) the tip's axes in that joint's frame.
        tip_from_joint: (3,) its origin there [m].
        capsule_joint: (c,) the joints that carry the capsules.
        capsule_ends: (c, 3, 2) in their frames [m].
        supports: (c, n) 1 where a joint moves a capsule, else 0.
        rows: (m,) the controlled ones of the six axes.
        in_tool: whether J is wanted in tool axes.
    """

    placed: Stack
    offset: Matrix
    motion: Matrix
    tip_joint: int
    tip_in_joint: Matrix
    tip_from_joint: Vector
    capsule_joint: Indices
    capsule_ends: Stack
    supports: Matrix
    rows: Indices
    in_tool: bool


def new_kinematics(q: Vector, m: int, links: int) -> Kinematics:
    """Return the arrays of an arm's kinematics, for `fill`; only the posture (n,) is in them."""
    n = len(q)
    return Kinematics(
        q.copy(), np.empty((6, n)), np.empty(3), np.empty((3, 3)), np.empty((6, n)),
        np.empty((m, n)), np.empty((links, 3)), np.empty((links, 3)))


new_kinematics_compiled = kernel(new_kinematics)


class JointPlaces(NamedTuple):
    """Where the joints are at one posture, in the base frame; the base itself comes first.

    Attributes:
        rotation: (n + 1, 3, 3) their axes.
        position: (n + 1, 3) their origins [m].
    """

    rotation: Stack
    position: Matrix


@kernel
def new_places(n: int) -> JointPlaces:
    """Return the arrays of `JointPlaces`; the base is in them."""
    places = JointPlaces(np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)))
    places.rotation[0], places.position[0] = np.eye(3), 0.0
    return places


@kernel
def place_joints(q: Vector, chain: Chain, places: JointPlaces, screws: OutMatrix) -> None:
    """Write where the joints are at a posture (n,), and their screws (6, n), see `Kinematics`.

    A joint's axes are turned about its own axis by Rodrigues' formula, row by row.
    """
    rotation, position = places.rotation, places.position
    placed, offset, motion = chain.placed, chain.offset, chain.motion
    for j in range(len(q)):
        x, y, z = motion[j, 3], motion[j, 4], motion[j, 5]
        sine, cosine = math.sin(q[j]), math.cos(q[j])
        turns = x != 0.0 or y != 0.0 or z != 0.0
        for i in range(3):
            u, v, w = rotation[j, i, 0], rotation[j, i, 1], rotation[j, i, 2]
            a = u * placed[j, 0, 0] + v * placed[j, 1, 0] + w * placed[j, 2, 0]
            b = u * placed[j, 0, 1] + v * placed[j, 1, 1] + w * placed[j, 2, 1]
            c = u * placed[j, 0, 2] + v * placed[j, 1, 2] + w * placed[j, 2, 2]
            slide = a * motion[j, 0] + b * motion[j, 1] + c * motion[j, 2]
            axis = a * x + b * y + c * z
            position[j + 1, i] = position[j, i] + q[j] * slide + (
                u * offset[j, 0] + v * offset[j, 1] + w * offset[j, 2])
            screws[i, j], screws[3 + i, j] = slide, axis
            if turns:
                along = (1.0 - cosine) * axis
                a, b, c = (cosine * a + along * x + sine * (b * z - c * y),
                           cosine * b + along * y + sine * (c * x - a * z),
                           cosine * c + along * z + sine * (a * y - b * x))
            rotation[j + 1, i, 0], rotation[j + 1, i, 1], rotation[j + 1, i, 2] = a, b, c
        # The base origin as a point of the turning body: v = x × w.
        u, v, w = screws[3, j], screws[4, j], screws[5, j]
        x, y, z = position[j + 1, 0], position[j + 1, 1], position[j + 1, 2]
        screws[0, j] += y * w - z * v
        screws[1, j] += z * u - x * w
        screws[2, j] += x * v - y * u


@kernel
def _fill_tip(places: JointPlaces, chain: Chain, arm: Kinematics) -> None:
    """Write the tip's pose and the Jacobians of an arm whose joints are placed."""
    joint, position, rotation = chain.tip_joint, arm.tip_position, arm.tip_rotation
    inner, offset = chain.tip_in_joint, chain.tip_from_joint
    for i in range(3):
        a, b, c = (places.rotation[joint, i, 0], places.rotation[joint, i, 1],
                   places.rotation[joint, i, 2])
        position[i] = places.position[joint, i] + a * offset[0] + b * offset[1] + c * offset[2]
        for k in range(3):
            rotation[i, k] = a * inner[0, k] + b * inner[1, k] + c * inner[2, k]
    x, y, z = position[0], position[1], position[2]
    screws, tip_jacobian, jacobian, rows = (
        arm.joint_screws, arm.tip_jacobian, arm.jacobian, chain.rows)
    for j in range(screws.shape[1]):
        v1, v2, v3 = screws[0, j], screws[1, j], screws[2, j]
        w1, w2, w3 = screws[3, j], screws[4, j], screws[5, j]
        # v = v₀ + w × x at the tip point x.
        tip_jacobian[0, j] = v1 + w2 * z - w3 * y
        tip_jacobian[1, j] = v2 + w3 * x - w1 * z
        tip_jacobian[2, j] = v3 + w1 * y - w2 * x
        tip_jacobian[3, j], tip_jacobian[4, j], tip_jacobian[5, j] = w1, w2, w3
        for i in range(len(rows)):
            if chain.in_tool:
                part, axis = 3 * (rows[i] // 3), rows[i] % 3
                jacobian[i, j] = (rotation[0, axis] * tip_jacobian[part, j]
                                  + rotation[1, axis] * tip_jacobian[part + 1, j]
                                  + rotation[2, axis] * tip_jacobian[part + 2, j])
            else:
                jacobian[i, j] = tip_jacobian[rows[i], j]


@kernel
def _fill_links(places: JointPlaces, chain: Chain, start: OutMatrix, end: OutMatrix) -> None:
    """Write the ends of the capsules, (c, 3) each [m]."""
    rotation, position, ends = places.rotation, places.position, chain.capsule_ends
    for k in range(len(chain.capsule_joint)):
        joint = chain.capsule_joint[k]
        for i in range(3):
            a, b, c = rotation[joint, i, 0], rotation[joint, i, 1], rotation[joint, i, 2]
            start[k, i] = (
                position[joint, i] + a * ends[k, 0, 0] + b * ends[k, 1, 0] + c * ends[k, 2, 0])
            end[k, i] = (
                position[joint, i] + a * ends[k, 0, 1] + b * ends[k, 1, 1] + c * ends[k, 2, 1])


@kernel
def fill_tip(chain: Chain, places: JointPlaces, arm: Kinematics) -> None:
    """Write an arm's kinematics but for its capsules.

    Args:
        chain: the arm.
        places: room for its joints, from `new_places`.
        arm: what is written.
    """
    place_joints(arm.q, chain, places, arm.joint_screws)
    _fill_tip(places, chain, arm)


@kernel
def fill(chain: Chain, places: JointPlaces, arm: Kinematics) -> None:
    """Write an arm's kinematics at the posture that is in it, see `fill_tip`."""
    fill_tip(chain, places, arm)
    _fill_links(places, chain, arm.segment_start, arm.segment_end)


@entry
def fill_kinematics(chain: Packed[Chain], arm: Kinematics) -> None:
    """Do what `fill` does, for Python, which hands arrays over sooner than it takes them back."""
    fill(chain.value, new_places(len(arm.q)), arm)


@kernel
def _apart(one: Vector, other: Vector) -> float:
    x, y, z = one[0] - other[0], one[1] - other[1], one[2] - other[2]
    return math.sqrt(x * x + y * y + z * z)


@kernel
def way_of_link(
    link: int, start: Matrix, end: Matrix, start_then: Matrix, end_then: Matrix,
) -> float:
    """Return how far any point of a link's segment has moved at the most [m]: one of its ends."""
    return max(_apart(start[link], start_then[link]), _apart(end[link], end_then[link]))


@kernel
def one_of(arms: KinematicsAlong, at: int) -> Kinematics:
    """Return the kinematics at one of several postures, as views."""
    return Kinematics(
        arms.q[at], arms.joint_screws[at], arms.tip_position[at], arms.tip_rotation[at],
        arms.tip_jacobian[at], arms.jacobian[at], arms.segment_start[at], arms.segment_end[at])


@kernel
def along_in(q: Matrix, chain: Chain) -> KinematicsAlong:
    """Return the arm's kinematics at N postures (N, n): N leads every array."""
    count, n = q.shape
    m, links = len(chain.rows), len(chain.capsule_joint)
    arms = KinematicsAlong(
        q.copy(), np.empty((count, 6, n)), np.empty((count, 3)), np.empty((count, 3, 3)),
        np.empty((count, 6, n)), np.empty((count, m, n)), np.empty((count, links, 3)),
        np.empty((count, links, 3)))
    places = new_places(n)
    for i in range(count):
        fill(chain, places, one_of(arms, i))
    return arms


@kernel
def links_along(q: Matrix, chain: Chain) -> tuple[Stack, Stack]:
    """Return the ends of the capsules at N postures (N, n), (N, c, 3) each [m]."""
    count, n = q.shape
    links = len(chain.capsule_joint)
    start, end = np.empty((count, links, 3)), np.empty((count, links, 3))
    places, screws = new_places(n), np.empty((6, n))
    for i in range(count):
        place_joints(q[i], chain, places, screws)
        _fill_links(places, chain, start[i], end[i])
    return start, end


@entry
def kinematics_along(q: Matrix, chain: Chain) -> KinematicsAlong:
    """Do what `along_in` does, for Python."""
    return along_in(q, chain)
