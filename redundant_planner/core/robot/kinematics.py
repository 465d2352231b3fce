"""Forward kinematics and Jacobians at one posture, from the joints' screws and placements."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import entry, Indices, kernel, Matrix, Stack, Stacks, Vector

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
        tip_joint: number of the joint that carries the tip frame.
        tip_in_joint: (3, 3) the tip's axes in that joint's frame.
        tip_from_joint: (3,) its origin there [m].
        capsule_joint: (c,) the joints that carry the capsules.
        capsule_ends: (c, 3, 2) in their frames [m].
        supports: (c, n) 1 where a joint moves a capsule, else 0.
        rows: (m,) the controlled ones of the six axes.
        in_tool: whether J is wanted in tool axes.
    """

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


@kernel
def fill_tip(
    screws: Matrix, rotations: Stack, positions: Matrix, chain: Chain, arm: Kinematics,
) -> None:
    """Write the tip's pose, the joint screws and the Jacobians of an arm, see `fill`."""
    joint, position, rotation = chain.tip_joint, arm.tip_position, arm.tip_rotation
    for axis in range(3):
        position[axis] = positions[joint, axis]
        for k in range(3):
            position[axis] += rotations[joint, axis, k] * chain.tip_from_joint[k]
            rotation[axis, k] = 0.0
            for other in range(3):
                rotation[axis, k] += (
                    rotations[joint, axis, other] * chain.tip_in_joint[other, k])
    x, y, z = position
    tip_jacobian, jacobian, rows = arm.tip_jacobian, arm.jacobian, chain.rows
    for j in range(len(screws)):
        v1, v2, v3, w1, w2, w3 = screws[j]
        arm.joint_screws[:, j] = screws[j]
        # v = v₀ + w × x at the tip point x.
        tip_jacobian[0, j] = v1 + w2 * z - w3 * y
        tip_jacobian[1, j] = v2 + w3 * x - w1 * z
        tip_jacobian[2, j] = v3 + w1 * y - w2 * x
        tip_jacobian[3:, j] = screws[j, 3:]
        for i in range(len(rows)):
            jacobian[i, j] = tip_jacobian[rows[i], j]
            if chain.in_tool:
                part, axis = 3 * (rows[i] // 3), rows[i] % 3
                jacobian[i, j] = 0.0
                for k in range(3):
                    jacobian[i, j] += rotation[k, axis] * tip_jacobian[part + k, j]


@kernel
def fill(
    screws: Matrix, rotations: Stack, positions: Matrix, chain: Chain, arm: Kinematics,
) -> None:
    """Write all fields of an arm's kinematics but the posture.

    Args:
        screws, rotations, positions: from `JointFrames.at`.
        chain: the arm.
        arm: what is written.
    """
    fill_tip(screws, rotations, positions, chain, arm)
    start, end = arm.segment_start, arm.segment_end
    for capsule in range(len(chain.capsule_joint)):
        joint, ends = chain.capsule_joint[capsule], chain.capsule_ends[capsule]
        for axis in range(3):
            start[capsule, axis] = end[capsule, axis] = positions[joint, axis]
            for k in range(3):
                start[capsule, axis] += rotations[joint, axis, k] * ends[k, 0]
                end[capsule, axis] += rotations[joint, axis, k] * ends[k, 1]


@entry
def fill_kinematics(
    screws: Matrix, rotations: Stack, positions: Matrix, chain: Chain, arm: Kinematics,
) -> None:
    """Do what `fill` does, for Python, which hands arrays over sooner than it takes them back."""
    fill(screws, rotations, positions, chain, arm)


@kernel
def one_of(arms: KinematicsAlong, at: int) -> Kinematics:
    """Return the kinematics at one of several postures, as views."""
    return Kinematics(
        arms.q[at], arms.joint_screws[at], arms.tip_position[at], arms.tip_rotation[at],
        arms.tip_jacobian[at], arms.jacobian[at], arms.segment_start[at], arms.segment_end[at])


@entry
def kinematics_along(
    q: Matrix, screws: Stack, rotations: Stacks, positions: Stack, chain: Chain,
) -> KinematicsAlong:
    """Return the arm's kinematics at N postures (N, n); N leads every argument, see `fill`."""
    count, n = q.shape
    m, links = len(chain.rows), len(chain.capsule_joint)
    arms = KinematicsAlong(
        q.copy(), np.empty((count, 6, n)), np.empty((count, 3)), np.empty((count, 3, 3)),
        np.empty((count, 6, n)), np.empty((count, m, n)), np.empty((count, links, 3)),
        np.empty((count, links, 3)))
    for i in range(count):
        fill(screws[i], rotations[i], positions[i], chain, one_of(arms, i))
    return arms
