"""What ~/target calls a target: written there by the planner, and read by those who sent it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from redundant_planner.core.robot.quaternions import quaternion_of
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.goal import Goal, Target, TipTargets

# The key of that text in the status.
TARGET = 'target'


def text_of_target(target: Target | TipTargets, joint_names: Sequence[str]) -> str:
    """Return the text of a target.

    Of a tip place and quaternion, x y z and x y z w, in the base frame; of the joints
    name=position for each; of a chunk how much it has, and its end.

    Args:
        target: a pose [m], joint positions (n,) [rad, m], a chunk, or the poses of several tips.
        joint_names: of the n joints.
    """
    if isinstance(target, Mapping):
        return '; '.join(f'{tip}: {text_of_target(pose, joint_names)}'
                         for tip, pose in target.items() if pose is not None)
    if isinstance(target, Chunk):
        return (f'{len(target.times)} points within {target.times[-1]:.3f} s, the last one at '
                f'{text_of_target(target.end, joint_names)}')
    if isinstance(target, Pose):
        return ' '.join(f'{number:.6f}' for number in (
            *target.position, *quaternion_of(target.rotation)))
    return ' '.join(f'{name}={position:.6f}' for name, position in zip(joint_names, target))


def goal_of_text(text: str, joint_names: Sequence[str]) -> Goal | None:
    """Return the pose, or the joint positions (n,) [rad, m], that a text gives; None for others.

    Args:
        text: of `text_of_target`.
        joint_names: of the n joints, in the order of the result.
    """
    words = text.split()
    try:
        if words and '=' in words[0]:
            positions = dict(word.rsplit('=', 1) for word in words)
            return np.array([float(positions[name]) for name in joint_names])
        x, y, z, *turn = map(float, words)
        if len(turn) != 4:
            return None
        return Pose(np.array((x, y, z)),
                    np.asarray(pin.Quaternion(np.array(turn)).toRotationMatrix()))
    except (ValueError, KeyError):
        return None


def text_of_tip(text: str, tip: str) -> str:
    """Return a tip's part of the text of targets of tips; empty if it has none."""
    parts = (part.partition(': ') for part in text.split('; '))
    return next((pose for name, _, pose in parts if name == tip), '')
