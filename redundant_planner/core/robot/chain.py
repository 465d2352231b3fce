"""What an arm's kinematics are computed from, out of Pinocchio's model of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.robot.capsules import Capsule, placed, supports_of
from redundant_planner.core.robot.kinematics import Chain

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

# Of an axis of length 1.
_ROUND_OFF = 1e-12


def chain_of(
    model: pin.Model, tip_ids: Sequence[int], capsules: Sequence[Capsule], rows: Indices, *,
    in_tool: bool,
) -> Chain:
    """Return what the kinematics are computed from at any posture.

    Args:
        model: of the joints that move.
        tip_ids: the tips' frames in it.
        capsules: on its links.
        rows: (m,) the controlled ones of the six axes of each tip.
        in_tool: whether J and twists are in tool axes.

    Raises:
        RobotError: a capsule has no place on the robot.
    """
    tips = [model.frames[tip] for tip in tip_ids]
    tip_joints = np.array([tip.parentJoint for tip in tips], dtype=np.intp)
    parents = np.array(list(model.parents)[1:], dtype=np.intp)
    capsule_joint, capsule_ends = placed(model, capsules)
    return Chain(
        parents, *_joint_placements(model), tip_joints,
        np.array([tip.placement.rotation for tip in tips]),
        np.array([tip.placement.translation for tip in tips]),
        supports_of(tip_joints, parents), capsule_joint, capsule_ends,
        supports_of(capsule_joint, parents), rows, in_tool)


def _joint_placements(model: pin.Model) -> tuple[Array, Array, Array]:
    """Return how the joints of a chain sit in each other's frames, and what they do.

    Pinocchio's versions show a joint's motion differently, but all of them J: the motion is its
    column, taken back into the joint's frame.

    Returns:
        (n, 3, 3) axes of each joint at position 0 in the frame of the joint before, (n, 3) its
        origin there [m], and (n, 6) its motion [v; w] per unit of q̇ in its own frame.
    """
    data, n = model.createData(), model.njoints - 1
    pin.computeJointJacobians(model, data, pin.neutral(model))
    screws = np.reshape(data.J, (6, n))
    placed, offset, motion = np.empty((n, 3, 3)), np.empty((n, 3)), np.zeros((n, 6))
    for j in range(n):
        placement = model.jointPlacements[j + 1]
        placed[j], offset[j] = placement.rotation, placement.translation
        moved = data.oMi[j + 1].actInv(pin.Motion(screws[:, j]))
        revolute = float(np.linalg.norm(moved.angular)) > 0.5
        axis = np.array(moved.angular if revolute else moved.linear)
        axis[np.abs(axis) < _ROUND_OFF] = 0.0
        motion[j, 3 * revolute:3 * revolute + 3] = axis / np.linalg.norm(axis)
    return placed, offset, motion
