"""Poses to geometry_msgs/PoseStamped and back."""

from __future__ import annotations

from geometry_msgs.msg import PoseStamped
import numpy as np
import pinocchio as pin

from redundant_planner.core.robot.quaternions import quaternion_of
from redundant_planner.core.robot.se3 import Pose


def pose_to_message(pose: Pose, frame: str) -> PoseStamped:
    """Return a pose in a frame as geometry_msgs/PoseStamped, without a stamp."""
    message = PoseStamped()
    message.header.frame_id = frame
    place, turn = message.pose.position, message.pose.orientation
    place.x, place.y, place.z = pose.position.tolist()
    turn.x, turn.y, turn.z, turn.w = quaternion_of(pose.rotation).tolist()
    return message


def pose_of_message(message: PoseStamped) -> Pose:
    """Return the pose of a message by a planner, whose quaternions are of unit length."""
    place, turn = message.pose.position, message.pose.orientation
    return Pose(np.array((place.x, place.y, place.z)),
                np.asarray(pin.Quaternion(turn.w, turn.x, turn.y, turn.z).toRotationMatrix()))
